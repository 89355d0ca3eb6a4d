"""How much more friction each joint has in one log than its model says."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.diagnosis.baseline.drift import LOOSE, change_of_each
from residual.errors import InputError
from residual.model.model import Model
from residual.model.nominal import GIVEN, Nominal, prepare_logs
from residual.recording import Array, Recording
from residual.robot.robot import Robot
from residual.signals.track import Filters

HELD = 1e-12  # variance of all that is not friction, relative to its own size


@dataclass(frozen=True, eq=False, slots=True)
class LogFriction:
    """Friction of one log, relative to the model's.

    Attributes:
        id: Label of the recording.
        change: Relative change of each joint's friction torque; NaN where the joint
            did not move or has no friction in the model. Shape (dof,).
        sd: Standard deviation of the change by the noise of the log. Shape (dof,).
    """

    id: str
    change: Array
    sd: Array


def friction_of_each(
    robot: Robot,
    recordings: Sequence[Recording],
    model: Model,
    told: Callable[[int], None] = lambda _: None,
) -> list[LogFriction]:
    """Return what each log says of the friction of each joint.

    Everything but friction is held to the model: what else is wrong with it shows as
    scatter between the logs, by which a trend is judged.

    Args:
        robot: The robot.
        recordings: Its logs.
        model: The model to go by.
        told: Called with the number of logs done.

    Raises:
        InputError: If the model has no friction, or the logs are not usable.
    """
    if not any(t.effect.brakes and len(t.joints) == 1 for t in model.terms):
        raise InputError(
            f"The model of {robot.name} has no friction, so none can be followed. "
            "Declare some in robot.toml, or give --model ID of one that has it."
        )
    out = []
    for i, one in enumerate(recordings):
        told(i)
        out.append(_of_one(robot, one, model))
    return out


def _of_one(robot: Robot, recording: Recording, model: Model) -> LogFriction:
    logs = prepare_logs(robot, [recording], None, Filters())
    now = replace(model, speed_floor=logs.speed_floor)
    size = np.abs(now.coefficients())
    held = np.diag(HELD * np.maximum(size, 1e-9) ** 2)
    nominal = Nominal(now, (GIVEN,) * len(now.terms), covariance=held)
    change, sd = change_of_each(nominal, logs, LOOSE)
    return LogFriction(recording.id, change, sd)
