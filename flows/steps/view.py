"""One log with all that is known of it: what was measured, predicted, and explained."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from flows.inputs.logs import is_run, read_sets
from flows.inputs.robots import load_of, robot_of
from flows.model_requests import View
from flows.settings import store_folder
from flows.steps.loop.track import nominal_of
from flows.storage.diagnosis import read_models, read_verdict
from residual.diagnosis.result import Finding, Verdict
from residual.errors import InputError
from residual.export.exported import Whole, body_of
from residual.recording import Array, Recording
from residual.robot.robot import Robot
from residual.robot.shapes import Look, look_of
from residual.threads import one_blas_thread
from warehouse.layout import find


@dataclass(frozen=True, eq=False, slots=True)
class Viewed:
    """What is shown of a log.

    Attributes:
        robot: The arm.
        look: What it looks like.
        log: The log.
        torque: Of each model, its torque [N m]: "nominal", and with a verdict
            "identified" and "augmented". Shapes (n, dof).
        effects: Every finding with its torque [N m]. Shapes (n, dof).
        verdict: The verdict; None where none was asked for.
        lines: What was understood of the log.
    """

    robot: Robot
    look: Look
    log: Recording
    torque: Mapping[str, Array]
    effects: tuple[tuple[Finding, Array], ...]
    verdict: Verdict | None
    lines: tuple[str, ...]


@one_blas_thread
def view(request: View) -> Viewed:
    """Read a log and compute the torque of its models.

    Raises:
        InputError: If the log, the robot or the verdict is not usable, or the verdict
            is of another robot.
    """
    store = store_folder(request.store)
    verdict, models = _models(request, store)
    robot = _robot(request, store, models)
    sets = read_sets(((request.log,), (), ()), robot, request.columns, store)
    (log,) = sets.fit
    if not models:
        models = {"nominal": nominal_of(robot, sets.fit)}
    torque = {name: model.predict(log) for name, model in models.items()}
    effects = tuple(
        (effect, torque["augmented"] - _without(models["augmented"], effect, log))
        for effect in (verdict.effects if verdict else ())
    )
    folder = _folder(request.robot)
    return Viewed(
        robot, look_of(robot, folder), log, torque, effects, verdict, sets.lines[1:]
    )


def _models(request: View, store: Path) -> tuple[Verdict | None, Mapping[str, Whole]]:
    if request.verdict is None:
        return None, {}
    found = find(store, request.verdict)
    if found.kind != "diagnoses":
        raise InputError(
            f"{request.verdict} is one of {found.kind}, expected a diagnosis. "
            "List them with: modelgap sql 'SELECT diagnosis_id, robot FROM diagnoses'."
        )
    models = read_models(store, found.id)
    kept = {k: m for k, m in models.items() if k != "plsr"}
    return read_verdict(store, found.id), kept


def _robot(request: View, store: Path, models: Mapping[str, Whole]) -> Robot:
    runs = [request.log] if is_run(request.log) else []
    word = request.robot
    if word is None and not models and runs:
        word = robot_of(runs, store)
    if word is None and not models:
        raise InputError(
            f"{request.log} does not say which robot it is of. Name it: --robot "
            "irb140, or a URDF file."
        )
    asked = None if word is None else load_of(word, runs, store)
    if not models:
        return asked
    own = body_of(models["augmented"]).robot
    if asked is not None and (asked.name, asked.dof) != (own.name, own.dof):
        raise InputError(
            f"--verdict {request.verdict} is of {own.name} with {own.dof} joints, "
            f"--robot says {asked.name} with {asked.dof}. Give a verdict of this robot."
        )
    return asked or own


def _without(model: Whole, effect: Finding, log: Recording) -> Array:
    """Torque of a model with one finding taken out; nothing is refitted."""
    return model.without(effect.name, effect.joints or None).predict(log)


def _folder(word: str | None) -> Path | None:
    """Return where the URDF of a robot lies; None for one that is built in."""
    if word is None or not Path(word).exists():
        return None
    return Path(word) if Path(word).is_dir() else Path(word).parent
