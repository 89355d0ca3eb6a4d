"""Identify a robot's model from logs or runs: read, fit, prove, export."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from flows.inputs.logs import is_run, read_words
from flows.inputs.robots import load
from flows.outputs import check_new_folder, check_writable, read_files, write_all
from flows.say import say
from flows.settings import store_folder
from flows.steps.diagnose import check_declared, echo
from residual.errors import InputError
from residual.robot.robot import Robot

if TYPE_CHECKING:
    from residual.identification.consistency import Consistent
    from residual.identification.identify import Identification
    from residual.identification.validation import AccelerationError
    from residual.model.compare import Errors

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
        kept: Id of the model in the store, None where it is not stored.
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
    kept: str | None = None


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
    robot = load(request.robot)
    options = _options(request)
    if not request.logs:
        raise InputError(
            "No log to identify from. Name it first: modelgap identify LOG ... "
            "--robot R."
        )
    words, place = (*request.logs, *request.held_out), store_folder(request.store)
    logs = read_words(words, robot, request.columns, place)
    count = len(request.logs)
    fit, held_out = logs.recordings[:count], logs.recordings[count:]
    warnings = list(logs.warnings)
    say(console, *(echo(fit, (), held_out), *logs.lines))
    # Late, so that a wrong word is answered before the numerics are loaded.
    from threadpoolctl import threadpool_limits

    from residual.identification.identify import identify as fitted
    from residual.signals.split import hold_out_end, session_clock

    same_run = not held_out
    if same_run:
        fit, held_out = hold_out_end(fit)
        warnings = [*warnings, SAME_RUN]
    with threadpool_limits(1, user_api="blas"):
        clock = session_clock([*fit, *held_out])
        found = fitted(robot, fit, request.declared, options, clock)
        made = (found, fit, held_out)
        outcome = _proved(request, robot, made, (same_run, warnings))
    return _keep(outcome, request, robot, logs.runs)


def tell(outcome: Outcome, request: Request, console: Console) -> None:
    """Write the files that were asked for and print the outcome.

    Raises:
        InputError: If what was identified cannot be written as a URDF.
        OSError: If a file cannot be written.
    """
    # Late: tables and JSON are of no use to a wrong word.
    from flows.keep.identification_json import document
    from flows.report.terminal.identification import print_outcome
    from flows.steps.diagnose import verdict_json

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
        say(console, f"wrote {path}")
    if outcome.kept is not None:
        line = f"stored as a model: modelgap show {outcome.kept}"
        say(console, line)
    if request.json == "-":
        print(text, end="")


def _options(request: Request):
    from residual.identification.consistency import solver
    from residual.identification.identify import Options

    if request.consistent:
        solver()  # missing, it should be missed before the work
    check_declared(request.declared)
    return Options(request.method, "huber", request.prior, request.essential)


def _proved(request: Request, robot: Robot, made: tuple, about: tuple) -> Outcome:
    from residual.identification.consistency import consistent, least_mass_matrix
    from residual.identification.validation import acceleration_error, torque_errors

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
    from residual.model.export import robot_files

    if request.export is None:
        return {}
    bodies = outcome.consistent
    model = outcome.found.model if bodies is None else bodies.model
    return robot_files(model, f"identified from {' '.join(outcome.fit)}")


def _keep(
    outcome: Outcome, request: Request, robot: Robot, runs: Mapping[str, str]
) -> Outcome:
    """Store what was identified where it is from runs, or a store was named."""
    words = (*request.logs, *request.held_out)
    if request.store is None and len(runs) < len(words):
        return outcome
    from flows.keep.identification import store_identification

    # A held-out part of a fitted run is no run of its own.
    roles = {
        "fit": outcome.fit,
        "held_out": () if outcome.same_run else outcome.held_out,
    }
    by_role = {role: [runs[i] for i in ids if i in runs] for role, ids in roles.items()}
    count = len(request.logs)
    asked = {
        "step": "identify",
        "logs": [_whole(word, runs) for word in words[:count]],
        "held_out": [_whole(word, runs) for word in words[count:]],
        "robot": request.robot,
        "declared": request.declared,
        "method": request.method,
        "prior": request.prior,
        "essential": request.essential,
        "consistent": request.consistent,
        "robot_hash": robot.content_hash,
    }
    place = store_folder(request.store)
    return replace(outcome, kept=store_identification(place, outcome, asked, by_role))


def _whole(word: str, runs: Mapping[str, str]) -> str:
    """The whole id of a run; of a file its name, not where it lies."""
    found = [id for id in runs.values() if is_run(word) and id.startswith(word)]
    return found[0] if found else Path(word).name


def _check_files(request: Request) -> None:
    words = (*request.logs, *request.held_out, request.robot)
    written = {}
    if request.json not in (None, "-"):
        written["--json"] = Path(request.json)
    check_writable(written, read_files(words, request.columns))
    if request.export is not None:
        check_new_folder("--export", Path(request.export))
