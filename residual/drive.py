"""The drive of a joint that follows a goal: torque of an arm without torque sensors.

The torque of a position-controlled servo is its gain times the position error, and three
effects separate the logged goal from the torque: the firmware limits the speed of the
goal, the bus delivers it late, and the amplifier limits the torque.

tau = clip(gain · (g(t - delay) - q), -limit, limit),    |dg/dt| <= goal_speed
"""

from dataclasses import dataclass
from math import inf
from typing import ClassVar

import numpy as np

Array = np.ndarray

# Of an ideal drive; its torque is known up to a factor.
IDEAL = {"gain": 1.0, "limit": inf, "delay": 0.0, "goal_speed": inf}
FACTOR = (
    "Torques and sizes hold up to one factor a joint until a mass is weighed (--known "
    "payload.mass=...); a datasheet is a guess within a factor of two."
)


@dataclass(frozen=True, slots=True)
class Drive:
    """The chain from goal to torque, one value for each joint; empty where unknown."""

    gain: tuple[float, ...] = ()  # torque per angle [N m/rad]; 1 where empty
    limit: tuple[float, ...] = ()  # largest torque [N m]; none where empty
    delay: tuple[float, ...] = ()  # from a logged goal to its torque [s]; 0 where empty
    goal_speed: tuple[float, ...] = ()  # of the goal [rad/s]; no limit where empty
    enabled: str | None = None  # column that is 0 where the drives are off

    __pydantic_config__: ClassVar[dict] = {"extra": "forbid"}  # of a COLUMNS.toml

    def __post_init__(self) -> None:
        for name in IDEAL:
            values = getattr(self, name)
            if not all(0 < v < inf or v == IDEAL[name] for v in values):
                raise ValueError(f"{name} must be a list of positive numbers")
        lengths = {len(getattr(self, name)) for name in IDEAL} - {0}
        if len(lengths) > 1:
            raise ValueError("lists have different lengths, expected one per joint")

    @property
    def dof(self) -> int | None:
        """Number of joints with values; None without any."""
        return max(len(getattr(self, name)) for name in IDEAL) or None

    def values(self, name: str, dof: int) -> Array:
        """Return the values of a field, of an ideal drive if empty. (dof,).

        Args:
            name: Field: gain, limit, delay or goal_speed.
        """
        return np.array(getattr(self, name) or [IDEAL[name]] * dof, dtype=float)


def limit_goal(drive: Drive, goal: Array, t: Array) -> Array:
    """Return the goal that the drives follow: limited in speed, then late [rad].

    Args:
        goal: As logged [rad]. Shape (n, dof).
        t: Times of the samples [s]. Shape (n,).
    """
    dof = goal.shape[1]
    speed = drive.values("goal_speed", dof)
    followed, step = np.array(goal, dtype=float), np.diff(t)
    for j in np.flatnonzero(np.isfinite(speed)):
        at, line = float(goal[0, j]), followed[:, j]
        reach = (speed[j] * step).tolist()
        for i, (end, most) in enumerate(zip(goal[1:, j].tolist(), reach, strict=True)):
            at += min(max(end - at, -most), most)
            line[i + 1] = at
    late = drive.values("delay", dof)
    for j in np.flatnonzero(late):
        followed[:, j] = np.interp(t - late[j], t, followed[:, j])
    return followed


def compute_drive_torque(
    drive: Drive, goal: Array, q: Array, t: Array, enabled: Array | None = None
) -> tuple[Array, Array]:
    """Return the torque of the drives [N m], and a mask of samples at the limit.

    Args:
        goal, q: Goal as logged and position [rad]. Shapes (n, dof).
        t: Times of the samples [s]. Shape (n,).
        enabled: 0 where a drive is off; None for on. Shape (n,) or (n, dof).

    Returns:
        Torques, and a mask. Shapes (n, dof).
    """
    dof = goal.shape[1]
    gain, limit = (drive.values(name, dof) for name in ("gain", "limit"))
    tau = gain * (limit_goal(drive, goal, t) - q)
    on = np.ones(tau.shape, bool)
    if enabled is not None:
        on &= (enabled if enabled.ndim == 2 else enabled[:, None]) != 0
    at_limit = (np.abs(tau) >= limit) & on
    return np.where(on, np.clip(tau, -limit, limit), 0.0), at_limit
