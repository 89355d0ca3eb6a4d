"""What the torque of a joint may be made of, before its log is believed.

The body of the robot file within a rough prior, a load on its flange, and one broad
column for each thing that arms have beside their body. A fault must explain more than
all of these can.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg import cholesky

from residual.check.motion import Motion
from residual.check.rules import CHECK
from residual.evidence.priors import inertial_precision
from residual.recording import Array
from residual.robot.dynamics import (
    PER_LINK,
    flange_jacobian,
    gravity_torque,
    inertial_parameters,
    joints_length,
    regressor,
)
from residual.robot.robot import Robot

_NOTHING = 1e-9
OUTER = 5  # columns of the world around the arm: two tilts, a force in three axes
_FRICTION = (1, 2, 7, 8)  # of the columns beside the body


@dataclass(frozen=True, eq=False, slots=True)
class Columns:
    """The columns of one joint, each of the size of its prior, on its moving rows.

    Attributes:
        nominal: Torque of the robot file [N m]. Shape (n,).
        values: Torque of each coefficient of one [N m]. Shape (n, p).
        brake: Power that friction takes, per coefficient of one [W]. Shape (p,).
        rows: Rows that are used. Shape of all rows, bool.
    """

    nominal: Array
    values: Array
    brake: Array
    rows: Array


def columns(robot: Robot, motion: Motion) -> list[Columns]:
    """Return the columns of every joint."""
    y = regressor(robot.model, motion.q, motion.qd, motion.qdd)
    nominal = y @ inertial_parameters(robot.model)
    size = np.sqrt(np.mean(nominal**2, axis=0))
    size = np.maximum(size, CHECK.least_size * max(size.max(), _NOTHING))
    root = _inertial_root(robot)
    outer = _outer(robot, motion)
    out = []
    for j in range(motion.dof):
        use, first = motion.moving[:, j], PER_LINK * j
        local = size[j] * _local(motion, j, use)
        body = y[use, j, first:] @ root[first:]
        brake = np.zeros(local.shape[1])
        if use.any():
            friction = local[:, _FRICTION] * motion.qd[use, j, None]
            brake[list(_FRICTION)] = friction.mean(axis=0)
        values = np.column_stack([local, outer[use, j], body])
        brake = np.concatenate([brake, np.zeros(values.shape[1] - len(brake))])
        out.append(Columns(nominal[use, j], values, brake, use))
    return out


@lru_cache(maxsize=4)
def _inertial_root(robot: Robot) -> Array:
    """What a rough robot file leaves open, and a load that it may not have at all.

    The lower root of the covariance of its parameters; motions and readings share it.
    """
    out = CHECK.body**2 * np.linalg.inv(inertial_precision(robot))
    lever = CHECK.lever * joints_length(robot.model)
    sizes = _mass(robot) * np.array([1.0] + 3 * [lever] + 6 * [lever**2])
    out += np.diag(np.tile((CHECK.strange * sizes) ** 2, robot.dof))
    out[-PER_LINK:, -PER_LINK:] += np.diag((CHECK.load * sizes) ** 2)
    return cholesky(out, lower=True)


def _mass(robot: Robot) -> float:
    return sum(body.mass for body in list(robot.model.inertias)[1:])


def _outer(robot: Robot, motion: Motion) -> Array:
    """Torques of a tilted base and of a force on the flange. Shape (n, dof, 5)."""
    down = np.asarray(robot.model.gravity.linear)
    gravity = np.linalg.norm(down)
    across = np.delete(np.eye(3), np.argmax(np.abs(down)), axis=0)
    tilts = [
        gravity_torque(robot.model, motion.q, CHECK.tilt * gravity * axis)
        for axis in across
    ]
    force = CHECK.pull * _mass(robot) * max(gravity, 1.0)
    pulls = force * flange_jacobian(robot.model, motion.q)[:, :3]
    return np.concatenate([np.stack(tilts, axis=2), pulls.transpose(0, 2, 1)], axis=2)


def _local(motion: Motion, j: int, use: Array) -> Array:
    """Rotor, friction in several forms, and what follows the angle. Shape (n, 10)."""
    q, qd, qdd = (x[use, j] for x in (motion.q, motion.qd, motion.qdd))
    speed, hard, wide = (_rms(x) for x in (qd, qdd, q - q.mean() if len(q) else q))
    return np.column_stack(
        [
            qdd / hard,
            qd / speed,
            np.tanh(qd / (0.05 * speed)),
            np.ones_like(q),
            0.5 * np.sin(q),
            0.5 * np.cos(q),
            0.5 * (q - q.mean() if len(q) else q) / wide,
            0.5 * np.abs(qd) / speed,
            0.5 * np.abs(qd) * qd / speed**2,
        ]
    )


def _rms(x: Array) -> float:
    return max(float(np.sqrt(np.mean(x**2))) if len(x) else 1.0, 1e-6)
