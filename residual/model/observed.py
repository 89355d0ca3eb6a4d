"""What a model sees of the pieces of long logs, one at a time."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.effects.base import State
from residual.model.model import Model
from residual.recording import Array
from residual.robot.dynamics import (
    inverse_dynamics,
    regressor,
    with_inertial_parameters,
)
from residual.robot.robot import Robot
from residual.signals.pieces import spread
from residual.signals.track import Track

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


class Observed(Sequence):
    """States of many tracks; their regressors are not kept.

    Args:
        model: The model whose torque they hold.
        tracks: Signals of the pieces.
    """

    def __init__(self, model: Model, tracks: Sequence[Track]) -> None:
        self._model, self._tracks = model, tracks
        self._known: list[State | None] = [None] * len(tracks)

    def __len__(self) -> int:
        return len(self._tracks)

    def __getitem__(self, i: int) -> State:
        if self._known[i] is None:
            track = self._tracks[i]
            late = Later(self._model.robot, (track.q, track.qd, track.qdd))
            self._known[i] = self._model.observe(track, late)
        return self._known[i]


def with_regressor(state: State) -> State:
    """The same with a regressor that is read many times."""
    return replace(state, regressor=np.asarray(state.regressor))


def observed(model: Model, tracks: Sequence[Track]) -> Sequence[State]:
    """What a model's effects see of logs; of long ones it is made when it is needed.

    Args:
        model: The model.
        tracks: Signals of the logs.
    """
    if is_long(tracks):
        return Observed(model, tracks)
    return [model.observe(track) for track in tracks]


def is_long(tracks: Sequence[Track]) -> bool:
    """Whether logs are too long to be kept whole."""
    return len(spread([t.seconds for t in tracks])) < len(tracks)
