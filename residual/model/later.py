"""An inertial regressor that is not kept: 360 numbers a row for six joints."""

from dataclasses import dataclass

import numpy as np

from residual.recording import Array
from residual.robot.dynamics import (
    inverse_dynamics,
    regressor,
    with_inertial_parameters,
)
from residual.robot.robot import Robot
from residual.signals.track import Track

MANY = 60_000  # rows whose regressor takes 170 MB for six joints
AT_ONCE = 1 << 13  # rows of a regressor


@dataclass(frozen=True, eq=False, slots=True)
class Later:
    """An inertial regressor that is made when somebody reads it.

    Attributes:
        robot: The arm.
        motion: q, qd and qdd [rad, rad/s, rad/s^2]. Shapes (n, dof).
    """

    robot: Robot
    motion: tuple[Array, Array, Array]

    def __array__(self, dtype=None, copy=None) -> Array:
        return self._of(slice(None))

    def __getitem__(self, key) -> Array:
        """Some of it: rows, or columns of all rows as [:, :, columns]."""
        if isinstance(key, slice):
            return self._of(key)
        rest = key[1:]
        starts = range(0, len(self.motion[0]), AT_ONCE)
        blocks = (self._of(slice(i, i + AT_ONCE)) for i in starts)
        parts = [block[(slice(None), *rest)] for block in blocks]
        return np.concatenate(parts)[key[0]]

    def _of(self, rows: slice) -> Array:
        return regressor(self.robot.model, *(x[rows] for x in self.motion))

    def __matmul__(self, parameters: Array) -> Array:
        """Torque of these inertial parameters [N m]. Shape (n, dof).

        By the recursive algorithm, in a third of the time.
        """
        body = with_inertial_parameters(self.robot.model, parameters)
        return inverse_dynamics(body, *self.motion)


def read_late(robot: Robot, track: Track) -> Array | Later:
    """Return the regressor of a log, of many rows one that is made when it is read."""
    late = Later(robot, (track.q, track.qd, track.qdd))
    return late if len(track.t) > MANY else np.asarray(late)
