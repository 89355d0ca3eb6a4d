"""What share of each part of the model a torque has: its weight, inertia, friction.

A plain regression, joint by joint, of the torque on that of the robot file, beside
friction, an offset and a rotor of any size:

tau = share * nominal + a qd + b sign(qd) + c + d qdd,

and the same with the nominal torque in two parts, weight and inertia. A rough file, a
load or a gear's losses leave the shares near one on the joints that carry the arm;
torque in another unit, or torque that some part was taken from, does not.
"""

from dataclasses import dataclass

import numpy as np

from residual.check.motion import Motion
from residual.check.rules import CHECK
from residual.recording import Array
from residual.robot.dynamics import gravity_torque, inertial_parameters, regressor
from residual.robot.robot import Robot

_TILTS = 2
_NOTHING = 1e-12
_ALIKE = 1e-9  # of the power of a direction of the columns: below it is none
_SILENT = (np.nan, np.inf, 0.0, np.nan, np.inf, np.nan, 0.0, *2 * (np.nan, np.inf))


@dataclass(frozen=True, eq=False, slots=True)
class Shares:
    """Shares of the model that each torque has; not a number where it does not show.

    Attributes:
        whole, whole_sd: Share of the whole nominal torque, and its deviation. (dof,).
        seen: What the nominal torque explains of what friction leaves, 0 to 1. (dof,).
        weight, weight_sd: Share of the nominal weight. Shape (dof,).
        tilted: Share of the weight that it had along the other axes, the larger of the
            two, in size. Shape (dof,).
        load: Size of the nominal torque [N m]. Shape (dof,).
        inertia, inertia_sd: Share of the nominal inertia. Shape (dof,).
        friction: Power that friction takes [W]. Shape (dof,).
        friction_sd: Its deviation [W]. Shape (dof,).
    """

    whole: Array
    whole_sd: Array
    seen: Array
    weight: Array
    weight_sd: Array
    tilted: Array
    load: Array
    inertia: Array
    inertia_sd: Array
    friction: Array
    friction_sd: Array


def shares_of(robot: Robot, motion: Motion) -> Shares:
    """Return the shares of a motion."""
    y = regressor(robot.model, motion.q, motion.qd, motion.qdd)
    nominal = y @ inertial_parameters(robot.model)
    down = np.asarray(robot.model.gravity.linear)
    size = float(np.linalg.norm(down))
    across = np.delete(np.eye(3), np.argmax(np.abs(down)), axis=0)
    every = [gravity_torque(robot.model, motion.q, size * axis) for axis in across]
    weight = gravity_torque(robot.model, motion.q, down)
    parts = np.stack([weight, *every, nominal - weight], axis=2)
    strong = np.sqrt(np.mean(weight**2, axis=0))
    parts[:, strong <= CHECK.weightless * strong.max(), 0] = 0.0
    rows = [_joint(motion, j, nominal[:, j], parts[:, j]) for j in range(robot.dof)]
    return Shares(*(np.array(column) for column in zip(*rows, strict=True)))


def carries(shares: Shares, least: float = 0.1) -> Array:
    """Return which joints carry the arm: others are off by any factor. (dof,)."""
    return shares.load > least * shares.load.max()


def _beside(motion: Motion, joint: int, use: Array) -> Array:
    """Return friction, an offset and a rotor of any size. Shape (n, 4).

    Args:
        joint: Joint from 0.
        use: Rows that are used. Shape of all rows, bool.
    """
    qd, qdd = motion.qd[use, joint], motion.qdd[use, joint]
    slow = max(CHECK.turns * float(np.sqrt(np.mean(qd**2))), _NOTHING)
    return np.column_stack([qd, np.tanh(qd / slow), np.ones_like(qd), qdd])


def _joint(motion: Motion, j: int, nominal: Array, parts: Array) -> tuple:
    """The shares of one joint, in the order of the record."""
    use = motion.moving[:, j]
    if use.sum() < CHECK.fewest:
        return _SILENT
    rest, tau, qd = _beside(motion, j, use), motion.tau[use, j], motion.qd[use, j]
    _, _, without = _fit(rest, tau, motion.spread)
    columns = np.column_stack([nominal[use], rest])
    whole, sure, left = _fit(columns, tau, motion.spread)
    each, wide, _ = _fit(np.column_stack([parts[use], rest]), tau, motion.spread)
    # The power of friction is linear in its two coefficients.
    brake, heavy = np.mean(rest[:, :2] * qd[:, None], axis=0), 1 + _TILTS
    rubs = slice(heavy + 1, heavy + 3)
    return (
        whole[0],
        np.sqrt(sure[0, 0]),
        1 - left / max(without, _NOTHING),
        each[0],
        np.sqrt(wide[0, 0]),
        np.abs(each[1:heavy]).max(),
        np.sqrt(np.mean(nominal[use] ** 2)),
        each[heavy],
        np.sqrt(wide[heavy, heavy]),
        brake @ each[rubs],
        np.sqrt(brake @ wide[rubs, rubs] @ brake),
    )


def _fit(columns: Array, tau: Array, spread: float) -> tuple[Array, Array, float]:
    """Coefficients, their covariance, and the mean square that is left.

    Rows that are near in time count as one: ``spread`` of each is independent. What is
    not there, or not to be told from others, is as uncertain as it can be.
    """
    size = np.sqrt(np.mean(columns**2, axis=0)) + _NOTHING
    scaled = columns / size
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    values = np.maximum(values, _ALIKE * len(scaled))
    inverse = (vectors / values) @ vectors.T
    at = inverse @ (scaled.T @ tau)
    left = float(np.mean((tau - scaled @ at) ** 2))
    free = len(scaled) / max(len(scaled) - len(at), 1)
    covariance = inverse * free * left / spread / np.outer(size, size)
    gone = size < 2 * _NOTHING
    covariance[gone, gone] = np.inf
    return at / size, covariance, left
