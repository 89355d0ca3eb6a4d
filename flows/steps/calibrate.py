"""Calibrate a data-driven correction on logs or runs: read, compute, keep, tell."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from flows.inputs.logs import read_words
from flows.inputs.robots import load
from flows.outputs import (
    check_new_folder,
    check_writable,
    json_text,
    read_files,
    write_all,
)
from flows.say import say
from flows.settings import store_folder
from flows.steps.diagnose import Progress, check_declared, echo
from residual.errors import InputError
from residual.robot.robot import Robot

if TYPE_CHECKING:
    from residual.calibration.calibrate import Calibration
    from residual.calibration.rows import Run


@dataclass(frozen=True, slots=True)
class Request:
    """What a user wants calibrated, in his own words.

    Attributes:
        logs: Logs: "FILE", "FILE@start:end", or the id of a run.
        robot: Built-in name, URDF file or folder.
        paper: The paper's regressors and twin error.
        declared: Effects that the model has; None for the robot's own list.
        columns: COLUMNS.toml, None for the default columns.
        report: HTML page to write, or None.
        json: File for the figures as JSON, "-" for standard output, or None.
        export: Folder for the tables, or None.
        store: Folder of the store, None for the usual one.
    """

    logs: tuple[str, ...]
    robot: str
    paper: bool = False
    declared: tuple[str, ...] | None = None
    columns: str | None = None
    report: str | None = None
    json: str | None = None
    export: str | None = None
    store: str | None = None

    @property
    def files(self) -> dict[str, Path]:
        """Files to write, by option."""
        named = {"--report": self.report, "--json": self.json}
        return {k: Path(v) for k, v in named.items() if v is not None and v != "-"}


@dataclass(frozen=True, eq=False, slots=True)
class Read:
    """The logs of a calibration.

    Attributes:
        runs: The logs.
        ids: Full ids of those that are runs of the store.
        lines: What was understood of them, for the user.
        warnings: What is odd but usable.
    """

    runs: "tuple[Run, ...]"
    ids: tuple[str, ...]
    lines: tuple[str, ...]
    warnings: tuple[str, ...]

    @property
    def stored(self) -> bool:
        """Whether all of them are runs of the store."""
        return len(self.ids) == len(self.runs)


@dataclass(frozen=True, eq=False, slots=True)
class Outcome:
    """A calibration, and where it is kept.

    Attributes:
        made: The calibration.
        words: What it shows, in sentences.
        warnings: What is odd but usable.
        kept: Ids of the records by kind; empty where nothing was stored.
    """

    made: "Calibration"
    words: tuple[str, ...]
    warnings: tuple[str, ...]
    kept: Mapping[str, str]


def calibrate(
    request: Request, console: Console, progress: Progress | None = None
) -> Outcome:
    """Read logs, fit and validate every model, and store what was found.

    Args:
        request: What is wanted.
        console: Where people read.
        progress: Told the stage and the share done.

    Returns:
        The outcome, for `tell`.

    Raises:
        InputError: If the request or a log is not usable.
    """
    _check_files(request)
    robot = load(request.robot)
    check_declared(request.declared)
    read = read_runs(request, robot)
    say(console, *(echo(tuple(r.log for r in read.runs), (), ()), *read.lines))
    # Late, so that a wrong word is answered before the numerics are loaded.
    from threadpoolctl import threadpool_limits

    from flows.keep.calibration import Found, found_effects, store_calibration
    from flows.report.words.calibration import sentences
    from residual.calibration.calibrate import Settings
    from residual.calibration.calibrate import calibrate as fitted

    settings = Settings(paper=request.paper, declared=request.declared)
    place = store_folder(request.store)
    found = Found()
    if not request.paper:
        found = found_effects(place, read.ids, robot, request.declared)
    # One thread: the products are small, two threads only wait for each other.
    with threadpool_limits(1, user_api="blas"):
        made = fitted(robot, read.runs, settings, found.effects, progress)
    if found.line:
        made = replace(made, notes=(*made.notes, found.line))
    asked = {
        "step": "calibrate",
        "logs": list(read.ids),
        "robot": request.robot,
        "paper": request.paper,
        "declared": request.declared,
        "diagnosis": found.diagnosis,
        "robot_hash": robot.content_hash,
    }
    kept = store_calibration(place, made, asked) if read.stored else {}
    return Outcome(made, sentences(made), read.warnings, kept)


def tell(outcome: Outcome, request: Request, console: Console) -> None:
    """Write the files that were asked for and print the table.

    Raises:
        OSError: If a file cannot be written.
    """
    # Late: figures and tables are slow imports, of no use to a wrong word.
    from flows.keep.calibration_json import document
    from flows.report.terminal.calibration import print_outcome
    from residual.tables.lookup.export import export_lookup

    text = json_text(document(outcome))
    files: dict[Path, str | bytes] = {}
    if request.report is not None:
        from flows.report.page.calibration import render

        files[Path(request.report)] = render(outcome.made, outcome.warnings)
    if request.json not in (None, "-"):
        files[Path(request.json)] = text
    if request.export is not None:
        Path(request.export).mkdir(exist_ok=True)
        for name, content in export_lookup(outcome.made.lookup).items():
            files[Path(request.export) / name] = content
    write_all(files)
    print_outcome(outcome, console)
    lines = [f"wrote {path}" for path in files]
    if outcome.kept:
        ids = outcome.kept
        lines.append(
            f"stored: model {ids['model']}, validation {ids['validation']}: "
            f"modelgap show {ids['validation'][:8]}"
        )
    say(console, *lines)
    if request.json == "-":
        print(text, end="")


def read_runs(request: Request, robot: Robot) -> Read:
    """Read every log once: runs with their twin and family, files as they are.

    Raises:
        InputError: If a log is not usable or shares samples with another.
    """
    from residual.calibration.rows import Run

    if not request.logs:
        raise InputError(
            "No log to calibrate on. Name it first: modelgap calibrate LOG ... "
            "--robot R."
        )
    place = store_folder(request.store)
    logs = read_words(request.logs, robot, request.columns, place)
    runs, lines = [], []
    for log, line in zip(logs.recordings, logs.lines, strict=True):
        id = logs.runs.get(log.id)
        run = Run(log, *_beside(place, id)) if id else Run(log)
        runs.append(run)
        lines.append(_told(run) if id else line)
    return Read(tuple(runs), tuple(logs.runs.values()), tuple(lines), logs.warnings)


def _beside(store: Path, id: str) -> tuple[str | None, dict]:
    """Family of a stored run, and its errors against the twin."""
    from warehouse.files import read_parquet
    from warehouse.layout import find_run
    from warehouse.runs import read_channels

    row = read_parquet(find_run(store, id).row, ["trajectory"])
    channels = read_channels(store, id)
    twin = {name: c for name, c in channels.items() if name.startswith("e_")}
    return row.column("trajectory")[0].as_py(), twin


def _told(run: "Run") -> str:
    log, family = run.log, run.family or "unknown motion"
    return (
        f"{log.id}: run of {log.robot}, {family}, {len(log.t)} samples, "
        f"{log.duration:.2f} s"
    )


def _check_files(request: Request) -> None:
    words = (*request.logs, request.robot)
    check_writable(request.files, read_files(words, request.columns))
    if request.export is not None:
        check_new_folder("--export", Path(request.export))
