"""Identify a robot's model from logs or runs: read, fit, prove, export."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from flows.output import check_writable, write_all
from flows.settings import store_folder
from flows.steps import echo
from residual.errors import InputError
from residual.recording import Recording
from residual.robot import Robot, load_robot

if TYPE_CHECKING:
    from residual.compare import Errors
    from residual.consistency import Consistent
    from residual.identify import Identification
    from residual.validation import AccelerationError

SAME_RUN = (
    "no --holdout given: the last quarter of the longest log was held out; the proof "
    "is weak, since it is the same run"
)


@dataclass(frozen=True, slots=True)
class Request:
    """What a user wants identified, in his own words.

    Attributes:
        logs: Logs to fit: "FILE", "FILE@start:end", or the id of a run.
        robot: Built-in name, URDF file or folder.
        held_out: Logs for the proof; empty for the last quarter of the longest.
        declared: Effects that the model has; None for the robot's own list.
        method: "ols", "wls" or "irls".
        prior: Relative scale of the nominal prior, None for a free fit.
        essential: Whether to drop parameters that are not needed.
        consistent: Whether to find physically consistent parameters too.
        columns: COLUMNS.toml, None for the default columns.
        export: Folder for URDF and robot.toml, or None.
        json: File for the outcome as JSON, "-" for standard output, or None.
        store: Folder of the store, None for the usual one.
    """

    logs: tuple[str, ...]
    robot: str
    held_out: tuple[str, ...] = ()
    declared: tuple[str, ...] | None = None
    method: str = "wls"
    prior: float | None = None
    essential: bool = False
    consistent: bool = False
    columns: str | None = None
    export: str | None = None
    json: str | None = None
    store: str | None = None


@dataclass(frozen=True, eq=False, slots=True)
class Outcome:
    """What was identified, and how far it gets on held-out motion.

    Attributes:
        robot: The arm as described.
        found: The free fit.
        consistent: Physically consistent parameters, or None.
        errors: Torque errors by model: "nominal", "identified", "consistent".
        accelerations: Errors of acceleration from torque by model; None where M(q)
            is not positive definite.
        least_mass_matrix: Smallest eigenvalue of M(q) over random poses, by model.
        fit, held_out: Ids of the logs.
        same_run: Whether the held-out part is of a log that was fitted.
        warnings: What is odd but usable.
    """

    robot: Robot
    found: "Identification"
    consistent: "Consistent | None"
    errors: Mapping[str, "Errors"]
    accelerations: Mapping[str, "AccelerationError | None"]
    least_mass_matrix: Mapping[str, float]
    fit: tuple[str, ...]
    held_out: tuple[str, ...]
    same_run: bool
    warnings: tuple[str, ...]


def identify(request: Request, console: Console) -> Outcome:
    """Read logs, say what was understood of them, identify, and prove it.

    Args:
        request: What is wanted.
        console: Where people read.

    Returns:
        The outcome, for `tell`.

    Raises:
        InputError: If the request or a log is not usable.
    """
    _check_files(request)
    robot = load_robot(request.robot)
    options = _options(request)
    fit, held_out, lines, warnings = _read(request, robot)
    for line in (echo(fit, (), held_out), *lines):
        console.print(line, markup=False, highlight=False, soft_wrap=True)
    # Late, so that a wrong word is answered before the numerics are loaded.
    from threadpoolctl import threadpool_limits

    from residual.close import hold_out_end, session_clock
    from residual.identify import identify as fitted

    same_run = not held_out
    if same_run:
        fit, held_out = hold_out_end(fit)
        warnings = [*warnings, SAME_RUN]
    with threadpool_limits(1, user_api="blas"):
        clock = session_clock([*fit, *held_out])
        found = fitted(robot, fit, request.declared, options, clock)
        return _proved(request, robot, (found, fit, held_out), (same_run, warnings))


def tell(outcome: Outcome, request: Request, console: Console) -> None:
    """Write the files that were asked for and print the outcome.

    Raises:
        InputError: If what was identified cannot be written as a URDF.
        OSError: If a file cannot be written.
    """
    # Late: tables and JSON are of no use to a wrong word.
    from flows.identify_json import document
    from flows.identify_tables import print_outcome
    from flows.steps import verdict_json

    text = verdict_json(document(outcome))
    files: dict[Path, str | bytes] = {}
    if request.json not in (None, "-"):
        files[Path(request.json)] = text
    for name, content in _exported(outcome, request).items():
        files[Path(request.export or ".") / name] = content
    print_outcome(outcome, console)
    if request.export is not None:
        Path(request.export).mkdir(exist_ok=True)
    write_all(files)
    for path in files:
        console.print(f"wrote {path}", markup=False, highlight=False, soft_wrap=True)
    if request.json == "-":
        print(text, end="")


def _options(request: Request):
    from residual.consistency import solver
    from residual.effects import registry
    from residual.identify import Options
    from residual.names import check_name

    if request.consistent:
        solver()  # missing, it should be missed before the work
    for name in request.declared or ():
        check_name(name, registry(), "effect in --declared")
    return Options(request.method, "huber", request.prior, request.essential)


def _proved(request: Request, robot: Robot, made: tuple, about: tuple) -> Outcome:
    from residual.consistency import consistent, least_mass_matrix
    from residual.validation import acceleration_error, torque_errors

    found, fit, held_out = made
    same_run, warnings = about
    models = {"nominal": found.nominal, "identified": found.model}
    bodies = consistent(found) if request.consistent else None
    if bodies is not None:
        models["consistent"] = bodies.model
    least = {name: least_mass_matrix(model) for name, model in models.items()}
    accelerations = {}
    for name, model in models.items():
        try:
            accelerations[name] = acceleration_error(model, held_out)
        except InputError:
            accelerations[name] = None
    return Outcome(
        robot=robot,
        found=found,
        consistent=bodies,
        errors=torque_errors(models, held_out),
        accelerations=accelerations,
        least_mass_matrix=least,
        fit=tuple(r.id for r in fit),
        held_out=tuple(r.id for r in held_out),
        same_run=same_run,
        warnings=(*warnings, *found.preflight.lines(found.base), *_doubts(least)),
    )


def _doubts(least: Mapping[str, float]) -> list[str]:
    return [
        f"M(q) of the {name} model is not positive definite (least eigenvalue "
        f"{value:.3g} kg m^2): it predicts torque but cannot be simulated; "
        "--consistent gives one that can"
        for name, value in least.items()
        if value <= 0
    ]


def _exported(outcome: Outcome, request: Request) -> dict[str, bytes]:
    from residual.export import robot_files

    if request.export is None:
        return {}
    bodies = outcome.consistent
    model = outcome.found.model if bodies is None else bodies.model
    return robot_files(model, f"identified from {' '.join(outcome.fit)}")


def _read(request: Request, robot: Robot) -> tuple:
    """Read every log once: those to fit, those held out, lines and warnings."""
    from warehouse.logs import check_distinct, load_columns, unique_ids

    if not request.logs:
        raise InputError(
            "No log to identify from. Name it first: modelgap identify LOG ... "
            "--robot R."
        )
    columns = load_columns(request.columns) if request.columns else None
    words = (*request.logs, *request.held_out)
    store = store_folder(request.store)
    runs = [_is_run(word) for word in words]
    labels = iter(unique_ids([w for w, r in zip(words, runs, strict=True) if not r]))
    logs: list[Recording] = []
    lines, warnings = [], []
    for word, is_run in zip(words, runs, strict=True):
        if is_run:
            log, line = _read_run(word, robot, store)
            logs, lines = [*logs, log], [*lines, line]
            continue
        log, known = _read_file(word, robot, columns, next(labels))
        logs, lines = [*logs, log], [*lines, known.text]
        warnings += known.warnings
    check_distinct(logs)
    count = len(request.logs)
    return tuple(logs[:count]), tuple(logs[count:]), lines, warnings


def _is_run(word: str) -> bool:
    """Whether a word can only be the id of a run: no such file, and only hex digits."""
    return not Path(word).exists() and not set(word) - set("0123456789abcdef")


def _read_file(word: str, robot: Robot, columns, label: str) -> tuple:
    from warehouse.logs import read_log

    return read_log(word, robot, columns, label)


def _read_run(word: str, robot: Robot, store: Path) -> tuple[Recording, str]:
    from warehouse.runs import read_run

    log = read_run(store, word)
    if log.dof != robot.dof:
        raise InputError(
            f"Run {log.id} has {log.dof} joints, {robot.name} has {robot.dof}. Give "
            "the run's own robot with --robot."
        )
    line = f"{log.id}: run of {log.robot}, {len(log.t)} samples, {log.duration:.2f} s"
    return replace(log, id=log.id[:8]), line


def _check_files(request: Request) -> None:
    words: Sequence[str] = (*request.logs, *request.held_out, request.robot)
    files = [*words, *(word.rpartition("@")[0] for word in words)]
    read = [Path(word) for word in [*files, request.columns or ""] if word]
    written = {}
    if request.json not in (None, "-"):
        written["--json"] = Path(request.json)
    check_writable(written, read)
    if request.export is None:
        return
    place = Path(request.export)
    if place.exists() and not place.is_dir():
        raise InputError(f"--export {place} is a file, expected a folder.")
    if place.is_dir() and any(place.iterdir()):
        raise InputError(
            f"--export {place} is not empty. Name a new folder, so that nothing is "
            "overwritten."
        )
    if not place.resolve().parent.is_dir():
        raise InputError(
            f"--export {place}: there is no folder '{place.parent}'. Make it first."
        )
