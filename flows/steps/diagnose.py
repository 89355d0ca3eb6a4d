"""What the program does, as plain functions: read, diagnose, tell."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from rich.console import Console

from flows.inputs.logs import read_words
from flows.inputs.robots import load
from flows.outputs import check_writable, json_text, read_files, write_all
from flows.say import say
from flows.settings import store_folder
from residual.diagnosis.result import Diagnosis, Verdict
from residual.diagnosis.verdict import to_json
from residual.errors import InputError
from residual.names import check_name
from residual.recording import Recording
from residual.robot.robot import Robot

Progress = Callable[[str, float], None]


@dataclass(frozen=True, slots=True)
class Request:
    """What a user wants diagnosed, in his own words.

    Attributes:
        logs: Logs to diagnose: "FILE" or "FILE@start:end".
        robot: Built-in name, URDF file or folder.
        baseline: Logs of the robot in good order.
        held_out: Logs for the proof; empty for the last quarter of the longest.
        declared: Effects that the model has; None for the robot's own list.
        columns: COLUMNS.toml, None for the default columns.
        report: HTML page to write, or None.
        json: File for the verdict as JSON, "-" for standard output, or None.
        null: File of a calibrated null, or None.
        store: Folder of the store with runs and nulls, None for the usual one.
    """

    logs: tuple[str, ...]
    robot: str
    baseline: tuple[str, ...] = ()
    held_out: tuple[str, ...] = ()
    declared: tuple[str, ...] | None = None
    columns: str | None = None
    report: str | None = None
    json: str | None = None
    null: str | None = None
    store: str | None = None

    @property
    def files(self) -> dict[str, Path]:
        """Files to write, by option."""
        named = {"--report": self.report, "--json": self.json}
        return {k: Path(v) for k, v in named.items() if v is not None and v != "-"}


@dataclass(frozen=True, eq=False, slots=True)
class LogSets:
    """All logs of one diagnosis.

    Attributes:
        fit: Logs to diagnose.
        baseline: Logs of the robot in good order.
        held_out: Logs for the proof.
        lines: What was understood of them, for the user.
        warnings: What is odd but usable.
    """

    fit: tuple[Recording, ...]
    baseline: tuple[Recording, ...]
    held_out: tuple[Recording, ...]
    lines: tuple[str, ...]
    warnings: tuple[str, ...]


def diagnose(
    request: Request, console: Console, progress: Progress | None = None
) -> Diagnosis:
    """Read logs, say what was understood of them, and find what the model lacks.

    Args:
        request: What is wanted.
        console: Where people read.
        progress: Told the stage and the fraction done.

    Returns:
        The diagnosis, for `tell`.

    Raises:
        InputError: If the request or a log is not usable.
    """
    words = (*request.logs, *request.baseline, *request.held_out, request.robot)
    check_writable(request.files, read_files(words, request.columns, request.null))
    robot = load(request.robot)
    check_declared(request.declared)
    logs = read_logs(request, robot)
    say(console, *logs.lines)
    # Late, so that a wrong word is answered before the numerics are loaded.
    from threadpoolctl import threadpool_limits

    from residual.close import close_the_loop

    # One thread: the products are small, two threads only wait for each other.
    with threadpool_limits(1, user_api="blas"):
        found = close_the_loop(
            robot,
            logs.fit,
            baseline=logs.baseline,
            held_out=logs.held_out,
            declared=request.declared,
            progress=progress,
            null=_nulls(request),
        )
    say(console, *found.notes)
    return _with_reading(found, logs)


def tell(found: Diagnosis, request: Request, console: Console) -> None:
    """Write the files that were asked for and print the verdict.

    Args:
        found: The diagnosis.
        request: What is wanted.
        console: Where people read.

    Raises:
        OSError: If a file cannot be written.
    """
    # Late: the figures of the report are a slow import.
    from flows.report.terminal.diagnosis import print_diagnosis

    texts = {}
    if request.report is not None:
        from flows.report.page.diagnosis import render

        texts[Path(request.report)] = render(found, found.verdict.robot)
    verdict = verdict_json(found.verdict)
    if request.json not in (None, "-"):
        texts[Path(request.json)] = verdict
    write_all(texts)
    print_diagnosis(found, console)
    for path in texts:
        say(console, f"wrote {path}")
    if request.json == "-":
        print(verdict, end="")


def read_logs(request: Request, robot: Robot) -> LogSets:
    """Read every log once and make sure that no sample counts twice.

    Args:
        request: What is wanted.
        robot: The arm that was logged.

    Returns:
        The logs by their part.

    Raises:
        InputError: If a log is not usable or shares samples with another.
    """
    if not request.logs:
        raise InputError(
            "No log to diagnose. Name it first: modelgap diagnose LOG ... --robot R."
        )
    sets = {
        "fit": request.logs,
        "baseline": request.baseline,
        "held out": request.held_out,
    }
    specs = [spec for words in sets.values() for spec in words]
    read = read_words(specs, robot, request.columns, store_folder(request.store))
    sizes = [len(words) for words in sets.values()]
    fit, baseline, held_out = _split(list(read.recordings), sizes)
    lines = (echo(fit, baseline, held_out), *read.lines)
    return LogSets(fit, baseline, held_out, lines, read.warnings)


def echo(*sets: tuple[Recording, ...]) -> str:
    """Return one line that says which log is used as what.

    Args:
        sets: The logs to fit, of the baseline, and held out.
    """
    parts = []
    for name, logs in zip(("fit", "baseline", "held out"), sets, strict=True):
        labels = " ".join(log.id for log in logs) or "–"
        parts.append(f"{name}: {labels}")
    return " | ".join(parts)


def _with_reading(found: Diagnosis, logs: LogSets) -> Diagnosis:
    """Add what the readers said to what the diagnosis says."""
    warnings = (*logs.warnings, *found.warnings)
    return replace(
        found,
        verdict=replace(found.verdict, warnings=warnings),
        notes=(*logs.lines, *found.notes),
    )


def verdict_json(verdict: Verdict) -> str:
    """Return the verdict as JSON text."""
    return json_text(to_json(verdict))


def check_declared(names: tuple[str, ...] | None) -> None:
    """Refuse names in --declared that no effect has.

    Raises:
        UnknownNameError: With the nearest one.
    """
    from residual.effects import registry

    for name in names or ():
        check_name(name, registry(), "effect in --declared")


def _nulls(request: Request):
    """Return the null that is asked for, else those of the store to choose from."""
    from flows.steps.null import nulls_in, read_null

    if request.null is not None:
        return read_null(request.null)
    return nulls_in(store_folder(request.store))


def _split(items: list, sizes: list[int]) -> list[tuple]:
    parts, start = [], 0
    for size in sizes:
        parts.append(tuple(items[start : start + size]))
        start += size
    return parts
