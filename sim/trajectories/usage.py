"""How much of what an arm has a motion uses."""

from dataclasses import dataclass

import numpy as np

from residual.recording import Array
from residual.robot.robot import Robot
from sim.records import Reference
from sim.trajectories.excitation import Excitation, excitation
from sim.trajectories.limits import largest_torque

_SAMPLES = 1000  # that excitation is judged by


@dataclass(frozen=True, eq=False, slots=True)
class Usage:
    """Shares of the robot's own limits, NaN where it states none. Shapes (dof,).

    Attributes:
        range: Sweep of the motion, of the range.
        speed: Largest speed.
        acceleration: Largest acceleration.
        torque: Largest torque of the nominal model.
        excitation: What the motion tells about the base parameters.
    """

    range: Array
    speed: Array
    acceleration: Array
    torque: Array
    excitation: Excitation


def usage(robot: Robot, reference: Reference) -> Usage:
    """Return how much of a robot's limits a motion uses."""
    q, qd, qdd = reference.q, reference.qd, reference.qdd
    torque = largest_torque(robot, q, qd, qdd)
    rows = np.unique(np.linspace(0, len(q) - 1, _SAMPLES).astype(int))
    return Usage(
        _share(np.ptp(q, axis=0), robot.upper - robot.lower),
        _share(np.abs(qd).max(axis=0), robot.velocity_limit),
        _share(np.abs(qdd).max(axis=0), robot.acceleration_limit),
        _share(torque.max(axis=0), robot.torque_limit),
        excitation(robot.model, q[rows], qd[rows], qdd[rows]),
    )


def _share(used: Array, limit: Array | None) -> Array:
    limit = np.full(len(used), np.inf) if limit is None else np.asarray(limit)
    known = np.isfinite(limit) & (limit > 0)
    return np.where(known, used / np.where(known, limit, 1.0), np.nan)
