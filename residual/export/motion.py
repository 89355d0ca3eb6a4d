"""Motions on which an export is compared with its model: the same at every call."""

from dataclasses import dataclass

import numpy as np

from residual.recording import Array
from residual.robot.robot import Robot

USUAL_SPEED, USUAL_ACCELERATION = 2.0, 10.0  # rad/s, rad/s^2, where none is given
SECONDS, RATE = 10.0, 250.0
TRAVEL = 0.4  # of a joint's range to each side of its middle
WAVES = ((0.5, 1.0), (0.3, 2.7), (0.2, 5.3))  # share of the amplitude, times the lowest
LOWEST = 0.1  # Hz


@dataclass(frozen=True, eq=False, slots=True)
class Motion:
    """A motion that is known exactly.

    Attributes:
        t: Session time [s]. Shape (n,).
        q, qd, qdd: Motion [rad, rad/s, rad/s^2]. Shapes (n, dof).
    """

    t: Array
    q: Array
    qd: Array
    qdd: Array

    @property
    def parts(self) -> tuple[Array, Array, Array]:
        """Positions, velocities, accelerations."""
        return self.q, self.qd, self.qdd


def exciting(robot: Robot, seconds: float = SECONDS, rate: float = RATE) -> Motion:
    """Return three sines per joint, within its range and near its speed limit.

    Args:
        seconds: How long [s].
        rate: Samples per second [Hz].
    """
    lower, upper, speed = limits(robot)
    t = np.arange(round(seconds * rate)) / rate
    q, qd, qdd = np.zeros((3, len(t), robot.dof))
    for j in range(robot.dof):
        # No two joints ever repeat the same pose together.
        lowest = 2 * np.pi * LOWEST * (1 + 0.13 * j)
        fastest = sum(share * times * lowest for share, times in WAVES)
        size = min(TRAVEL * (upper[j] - lower[j]), 0.9 * speed[j] / fastest)
        for k, (share, times) in enumerate(WAVES):
            w, phase = times * lowest, j + 2.0 * k
            q[:, j] += size * share * np.sin(w * t + phase)
            qd[:, j] += size * share * w * np.cos(w * t + phase)
            qdd[:, j] -= size * share * w**2 * np.sin(w * t + phase)
    return Motion(t, q + (lower + upper) / 2, qd, qdd)


def random_states(robot: Robot, count: int, slowest: Array | float = 0.0) -> Motion:
    """Return states that have nothing to do with each other.

    Args:
        slowest: Least speed of each joint [rad/s]. Shape (dof,).
    """
    lower, upper, speed = limits(robot)
    limit = robot.acceleration_limit
    most = np.full(robot.dof, USUAL_ACCELERATION) if limit is None else limit
    # The same states at every call, so that a figure can be had again.
    rng = np.random.default_rng(0)
    shape = (count, robot.dof)
    fastest = np.maximum(speed, 2.0 * np.asarray(slowest))
    qd = rng.uniform(slowest, fastest, shape) * rng.choice([-1.0, 1.0], shape)
    q, qdd = rng.uniform(lower, upper, shape), rng.uniform(-most, most, shape)
    return Motion(np.arange(count) / RATE, q, qd, qdd)


def limits(robot: Robot) -> tuple[Array, Array, Array]:
    """Return range and speed of each joint, usual ones where there is none. (dof,)."""
    lower = np.where(np.isfinite(robot.lower), robot.lower, -np.pi)
    upper = np.where(np.isfinite(robot.upper), robot.upper, np.pi)
    known = np.isfinite(robot.velocity_limit)
    return lower, upper, np.where(known, robot.velocity_limit, USUAL_SPEED)
