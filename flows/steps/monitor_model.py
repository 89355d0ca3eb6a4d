"""From a diagnosis or the name of a robot to the model that a monitor starts from."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from flows.inputs.robots import load_of
from flows.storage.diagnosis import read_models, read_runs
from residual.errors import InputError
from residual.model.model import Model
from residual.model.nominal import declared_names, prepare_logs, start_nominal
from residual.recording import Recording
from residual.robot.robot import Robot
from residual.signals.track import Filters
from warehouse.layout import find, list_folders
from warehouse.objects.mirror import shown
from warehouse.runs import read_manifest

_GOOD = ("baseline", "fit")  # roles of a diagnosis' runs; the first that there is


@dataclass(frozen=True, slots=True)
class Source:
    """Where the model comes from.

    Attributes:
        robot: Name or file of the robot; None for that of the diagnosis.
        diagnosis: Id of the diagnosis, None for a nominal model.
        model: The augmented model of the diagnosis.
        good: Runs that it was made from, to calibrate on.
    """

    robot: str | None
    diagnosis: str | None = None
    model: Model | None = None
    good: tuple[str, ...] = ()


def source_of(word: str, store: Path) -> Source:
    """Say what a word stands for: a diagnosis of the store, else a robot.

    Args:
        word: Id of a diagnosis or its beginning, or what --robot takes.

    Raises:
        InputError: If the id is that of another record, or several begin with it.
    """
    ids = list_folders(store, "diagnoses")
    if not re.fullmatch("[0-9a-f]{1,20}", word) or Path(word).exists():
        return Source(word)
    if not any(id.startswith(word) for id in ids):
        raise InputError(
            f"'{word}' is no diagnosis in {shown(store)}. Name a robot such as irb140, "
            "or a diagnosis as in: modelgap sql 'SELECT diagnosis_id FROM diagnoses'."
        )
    id = find(store, word).id
    model = read_models(store, id)["augmented"]
    good = next((ids for role in _GOOD if (ids := read_runs(store, id, (role,)))), ())
    return Source(None, id, model, tuple(sorted(good)))


def model_of(source: Source, robot: Robot, runs: Sequence[Recording]) -> Model:
    """Return the model to start from; calibration fits its coefficients.

    Args:
        runs: Good runs: what counts as standing is learnt from them, where no
            diagnosis has told.
    """
    if source.model is not None:
        return source.model
    logs = prepare_logs(robot, runs, None, Filters())
    return start_nominal(logs, declared_names(robot, None)).model


def robot_of(source: Source, run: Recording, store: Path) -> Robot:
    """Return the robot, which must be described as it was when the run was made.

    Raises:
        InputError: If it is another robot, or described differently now.
    """
    known = source.model.robot if source.model else None
    robot = known or load_of(source.robot, [run.id], store)
    if robot.name != run.robot:
        raise InputError(
            f"Run {run.id} is of {run.robot}, the model of {robot.name}. Give runs of "
            "the robot, or its own model."
        )
    if robot.content_hash != read_manifest(store, run.id).get("robot_hash"):
        raise InputError(
            f"Run {run.id} was made with another description of {run.robot} than "
            f"{source.robot or 'the model'} has. Put back the URDF and robot.toml of "
            "that time."
        )
    return robot
