"""How much more friction each joint has in one log than its model says."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.errors import InputError
from residual.evidence.design import LAGS
from residual.evidence.fit import autocorrelation_time
from residual.model.model import Model
from residual.model.nominal import prepare_logs
from residual.recording import Array, Recording
from residual.robot.robot import Robot
from residual.signals.track import Filters, Track


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
    seen = [_seen(now, track) for track in logs.tracks]
    change, sd = np.full((2, robot.dof), np.nan)
    for j in range(robot.dof):
        friction, left = (np.concatenate(x)[:, j] for x in zip(*seen, strict=True))
        power = float(friction @ friction)
        if power > 0:
            change[j] = friction @ left / power
            left = left - change[j] * friction
            rows = sum(int(t.moving[:, j].sum()) for t in logs.tracks)
            slow = max(autocorrelation_time(left), 1.0)
            sd[j] = np.sqrt(slow * (left @ left) / rows / power)
    return LogFriction(recording.id, change, sd)


def _seen(model: Model, track: Track) -> tuple[Array, Array]:
    """Friction torque of the model on the rows of a log, and what it leaves [N m].

    Both 0 where a joint does not move, and on more rows than noise remembers behind the
    log. Shapes (rows + LAGS, dof).
    """
    state = model.observe(track)
    friction = np.zeros_like(track.q)
    for term in (*model.terms, *model.tables):
        if term.effect.brakes:
            term.add_to(friction, state)
    left = track.tau - track.filter(model.torque_seen(state))
    behind = np.zeros((LAGS, track.tau.shape[1]))
    parts = (track.filter(friction) * track.moving, left * track.moving)
    friction, left = (np.concatenate([part, behind]) for part in parts)
    return friction, left
