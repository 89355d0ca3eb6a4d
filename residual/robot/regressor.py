"""The inertial regressor of a motion, made when somebody reads it.

It has 360 numbers a row for six joints. The last ones are remembered, since many look
at the same motion, link by link: no link loads a joint that it is before, so that 210
are enough. Of one that is too large for that only what is asked for is made.
"""

from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from residual.recording import Array
from residual.robot.dynamics import (
    PER_LINK,
    inverse_dynamics,
    regressor,
    with_inertial_parameters,
)
from residual.robot.robot import Robot

AT_ONCE = 1 << 11  # rows of a regressor
LARGEST = 1 << 26  # bytes of one that is remembered: 40 000 rows for six joints
KEPT = 1 << 27  # bytes of all of them: thirteen minutes for six joints

_Known = OrderedDict[tuple, tuple[tuple, tuple[Array, ...]]]
_KNOWN: _Known = OrderedDict()


@dataclass(frozen=True, eq=False, slots=True)
class LazyRegressor:
    """An inertial regressor that is made when somebody reads it.

    Attributes:
        robot: The arm.
        motion: q, qd and qdd [rad, rad/s, rad/s^2]. Shapes (n, dof).
    """

    robot: Robot
    motion: tuple[Array, Array, Array]

    def __array__(self, dtype=None, copy=None) -> Array:
        n, dof = self.motion[0].shape
        out = np.zeros((n, dof, PER_LINK * dof))
        for i, block in enumerate(self.links()):
            out[:, : i + 1, PER_LINK * i : PER_LINK * (i + 1)] = block
        return out

    def __getitem__(self, key) -> Array:
        """Some of it: rows, or columns of all rows as [:, :, columns]."""
        if isinstance(key, slice):
            return self._of(key)
        dof = self.motion[0].shape[1]
        if isinstance(key[2], slice):
            first, stop, step = key[2].indices(PER_LINK * dof)
            i, start = divmod(first, PER_LINK)
            if step == 1 and stop <= PER_LINK * (i + 1):
                return self._of_link(i)[key[0], key[1], start : start + stop - first]
        return np.asarray(self)[key]

    def _of_link(self, i: int) -> Array:
        """Columns of one link's parameters. Shape (n, dof, 10)."""
        n, dof = self.motion[0].shape
        out = np.zeros((n, dof, PER_LINK))
        for k, block in enumerate(self.links()):
            if k == i:
                out[:, : i + 1] = block
        return out

    def __matmul__(self, parameters: Array) -> Array:
        """Torque of these inertial parameters [N m]. Shape (n, dof).

        By the recursive algorithm, in a third of the time, where it is not known.
        """
        known = self._remembered()
        if known is None:
            body = with_inertial_parameters(self.robot.model, parameters)
            return inverse_dynamics(body, *self.motion)
        out = np.zeros(self.motion[0].shape)
        for i, block in enumerate(known):
            own = parameters[PER_LINK * i : PER_LINK * (i + 1)]
            out[:, : i + 1] += (block.reshape(-1, PER_LINK) @ own).reshape(-1, i + 1)
        return out

    def links(self) -> tuple[Array, ...]:
        """Columns of each link on the joints that carry it. Shapes (n, i + 1, 10)."""
        known = self._remembered()
        return self._by_link() if known is None else known

    def _of(self, rows: slice) -> Array:
        return regressor(self.robot.model, *(x[rows] for x in self.motion))

    def _by_link(self) -> tuple[Array, ...]:
        n, dof = self.motion[0].shape
        out = tuple(np.empty((n, i + 1, PER_LINK)) for i in range(dof))
        for start in range(0, n, AT_ONCE):
            rows = slice(start, start + AT_ONCE)
            dense = self._of(rows)
            for i, block in enumerate(out):
                own = slice(PER_LINK * i, PER_LINK * (i + 1))
                block[rows] = dense[:, : i + 1, own]
        return out

    def _remembered(self) -> tuple[Array, ...] | None:
        """All of it, where it is small enough to be kept."""
        n, dof = self.motion[0].shape
        if 8 * PER_LINK * n * dof * (dof + 1) // 2 > LARGEST:
            return None
        # They are kept with the result, so that nothing else can get these ids.
        known = self.robot, *self.motion
        key = tuple(map(id, known))
        if key not in _KNOWN:
            _KNOWN[key] = known, self._by_link()
        _KNOWN.move_to_end(key)
        while len(_KNOWN) > 1 and _size() > KEPT:
            _KNOWN.popitem(last=False)
        return _KNOWN[key][1]


def _size() -> int:
    return sum(x.nbytes for _, blocks in _KNOWN.values() for x in blocks)


def links_of(regressor: Array | LazyRegressor, dof: int) -> Iterator[Array]:
    """Columns of each link on the joints that carry it. Shapes (n, i + 1, 10)."""
    if isinstance(regressor, LazyRegressor):
        yield from regressor.links()
    else:
        for i in range(dof):
            yield regressor[:, : i + 1, PER_LINK * i : PER_LINK * (i + 1)]
