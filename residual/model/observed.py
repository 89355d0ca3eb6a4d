"""What a model sees of the pieces of long logs, one at a time."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from residual.effects.base import State
from residual.model.later import Later
from residual.model.model import Model
from residual.signals.pieces import spread
from residual.signals.track import Track


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


def observed(
    model: Model, tracks: Sequence[Track], known: Sequence[State] = ()
) -> Sequence[State]:
    """What a model's effects see of logs; of long ones it is made when it is needed.

    Args:
        model: The model.
        tracks: Signals of the logs.
        known: What another model saw of them, whose regressors are the same.
    """
    if is_long(tracks):
        return Observed(model, tracks)
    rigid = [s.regressor for s in known] or [None] * len(tracks)
    return [model.observe(t, r) for t, r in zip(tracks, rigid, strict=True)]


def is_long(tracks: Sequence[Track]) -> bool:
    """Whether logs are too long to be kept whole."""
    return len(spread([t.seconds for t in tracks])) < len(tracks)
