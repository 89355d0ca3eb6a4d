"""The controller of an experiment with any model: by a spec, or by hand."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from flows.specs.experiment import NOMINAL, ControllerTable, ExperimentSpec
from flows.steps.loop.choose import Wanted, choose
from flows.storage.diagnosis import read_known
from flows.storage.export import read_model
from residual.errors import InputError
from residual.export.exported import Whole, body_of
from residual.model.control import Use, computed_torque, feed_forward
from residual.robot.robot import Robot
from sim.records import Reference
from warehouse.layout import find

ADOPTED, FEED_FORWARD = "adopted", "feed_forward"

Given = np.ndarray | Callable


def settled(spec: ExperimentSpec, robot: Robot, store: Path) -> ExperimentSpec:
    """Return a spec whose controller names its model by a whole id.

    Args:
        spec: The spec; its model may be "adopted", or the beginning of an id.

    Raises:
        InputError: If there is no such model, or none is adopted.
    """
    word = spec.controller.model
    if word == NOMINAL:
        return spec
    if word == ADOPTED:
        word = choose(robot, Wanted(store=store)).diagnosis or NOMINAL
    else:
        word = find(store, word).id
    table = spec.controller.model_copy(update={"model": word})
    return spec.model_copy(update={"controller": table})


def model_of(store: Path, word: str, robot: Robot) -> Whole:
    """Return the model that a controller is to have.

    Args:
        word: Id of a diagnosis (its augmented model, tables included), of a model, or
            of a calibration (its look-up tables); or a file that holds a model.

    Raises:
        InputError: If there is none, or it is of another robot.
    """
    if not Path(word).is_file() and find(store, word).kind == "diagnoses":
        model: Whole = read_known(store, find(store, word).id)
    else:
        model = read_model(store, word)
    own = body_of(model).robot
    if own.content_hash != robot.content_hash:
        raise InputError(
            f"The model of {word} is of {own.name} as it was described then, the robot "
            f"is {robot.name} as it is described now. Give a model of this one."
        )
    return model


def torque_of(model: Whole, reference: Reference, kind: str, use: Use) -> Given:
    """Return what drives an arm along a reference by a model: a torque, or a law.

    Args:
        kind: "feed_forward" for a torque along it, "computed_torque" for a law.
    """
    motion = reference.q, reference.qd, reference.qdd
    make = feed_forward if kind == FEED_FORWARD else computed_torque
    return make(model, reference.t, motion, use)


def given_by(
    table: ControllerTable, robot: Robot, reference: Reference, store: Path | None
) -> Given | None:
    """Return what a spec's controller drives the arm by; None for the nominal one.

    Args:
        table: The controller of the spec, its model named by a whole id.

    Raises:
        InputError: If its model is not there.
    """
    if table.model == NOMINAL:
        return None
    if store is None:
        raise InputError(f"Model {table.model} of the controller needs a store.")
    model = model_of(store, table.model, robot)
    return torque_of(model, reference, table.kind, Use())
