"""The inertial regressor of a motion, made when somebody reads it.

It has 360 numbers a row for six joints: of short logs it is remembered, since many look
at the same motion, of long ones only what is asked for is made.
"""

from collections import OrderedDict
from dataclasses import dataclass

import numpy as np

from residual.recording import Array
from residual.robot.dynamics import (
    inverse_dynamics,
    regressor,
    with_inertial_parameters,
)
from residual.robot.robot import Robot

AT_ONCE = 1 << 13  # rows of a regressor
LARGEST = 1 << 26  # bytes of one that is remembered: 23 000 rows for six joints
KEPT = 1 << 28  # bytes of all of them: ten minutes of six joints

_Known = OrderedDict[tuple, tuple[tuple, Array]]
_KNOWN: _Known = OrderedDict()


@dataclass(frozen=True, eq=False, slots=True)
class LazyRegressor:
    """An inertial regressor that is made when somebody reads it.

    Attributes:
        robot: The arm.
        motion: q, qd and qdd [rad, rad/s, rad/s^2]. Shapes (n, dof).
        once: Whether it is of a piece that nobody looks at for long.
    """

    robot: Robot
    motion: tuple[Array, Array, Array]
    once: bool = False

    def __array__(self, dtype=None, copy=None) -> Array:
        known = self._remembered()
        return self._of(slice(None)) if known is None else known

    def __getitem__(self, key) -> Array:
        """Some of it: rows, or columns of all rows as [:, :, columns]."""
        known = self._remembered()
        if known is not None:
            return known[key]
        if isinstance(key, slice):
            return self._of(key)
        rest = key[1:]
        starts = range(0, len(self.motion[0]), AT_ONCE)
        blocks = (self._of(slice(i, i + AT_ONCE)) for i in starts)
        parts = [block[(slice(None), *rest)] for block in blocks]
        return np.concatenate(parts)[key[0]]

    def __matmul__(self, parameters: Array) -> Array:
        """Torque of these inertial parameters [N m]. Shape (n, dof).

        By the recursive algorithm, in a third of the time, where it is not known.
        """
        known = self._remembered()
        if known is not None:
            n, dof, p = known.shape
            return (known.reshape(n * dof, p) @ parameters).reshape(n, dof)
        body = with_inertial_parameters(self.robot.model, parameters)
        return inverse_dynamics(body, *self.motion)

    def _of(self, rows: slice) -> Array:
        return regressor(self.robot.model, *(x[rows] for x in self.motion))

    def _remembered(self) -> Array | None:
        """All of it, where it is small enough to be kept."""
        n, dof = self.motion[0].shape
        if self.once or 80 * n * dof**2 > LARGEST:
            return None
        # They are kept with the result, so that nothing else can get these ids.
        known = self.robot, *self.motion
        key = tuple(map(id, known))
        if key not in _KNOWN:
            _KNOWN[key] = known, self._of(slice(None))
            _KNOWN[key][1].setflags(write=False)
        _KNOWN.move_to_end(key)
        while len(_KNOWN) > 1 and sum(x.nbytes for _, x in _KNOWN.values()) > KEPT:
            _KNOWN.popitem(last=False)
        return _KNOWN[key][1]
