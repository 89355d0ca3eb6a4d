"""A planned motion, and the checks that every family has to pass."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from residual.recording import Array
from residual.robot.robot import Robot
from sim.engine.geometry import MARGIN, Body, body, clearances
from sim.trajectories.limits import LimitError, between, check_limits

Motion = tuple[Array, Array, Array]  # q, qd and qdd, shapes (n, dof)

_FINE, _COARSE = 1000.0, 100.0  # Hz, for limits and for clearance


@dataclass(frozen=True, eq=False, slots=True)
class Plan:
    """A motion at any time.

    Attributes:
        kind: Family.
        curve: q, qd and qdd at any times from 0 to `duration`.
        duration: Length [s].
        period: Length of one repetition [s].
        once: Length from the start that shows all of it [s]: what comes after repeats.
    """

    kind: str
    curve: Callable[[Array], Motion]
    duration: float
    period: float
    once: float


def check(robot: Robot, plan: Plan) -> None:
    """Make sure that a motion keeps limits and clearance, between samples too.

    Raises:
        LimitError: With the joint, when, and by how much.
    """
    t = even(plan.once, _FINE)
    motion = plan.curve(t)
    check_limits(robot, plan.kind, t, motion)
    every = round(_FINE / _COARSE)
    check_clearance(body(robot.model), plan.kind, t[::every], motion[0][::every])


def check_clearance(arm: Body, kind: str, t: Array, q: Array) -> None:
    """Make sure that an arm stays clear of the floor and of itself.

    Args:
        t: Even times [s]. Shape (n,).
        q: Positions at those times [rad]. Shape (n, dof).

    Raises:
        LimitError: With what comes too near, when, and by how much.
    """
    space = clearances(arm, q)
    if not space.size:
        return
    space = space - between(space)
    row, worst = np.unravel_index(int(space.argmin()), space.shape)
    least = float(space[row, worst])
    if least < MARGIN:
        raise LimitError(
            f"{kind}: at {t[row]:.2f} s the room of {arm.names[worst]} is "
            f"{1000 * least:.0f} mm, needed {1000 * MARGIN:.0f} mm, "
            f"{1000 * (MARGIN - least):.0f} mm too little (arm as capsules of "
            f"{1000 * arm.radius:.0f} mm radius). Try another seed.",
            0,
            float(t[row]),
            least,
            MARGIN,
        )


def even(duration: float, rate: float) -> Array:
    """Return even times from 0 to the duration, both included [s]. Shape (n,)."""
    return np.arange(round(duration * rate) + 1) / rate
