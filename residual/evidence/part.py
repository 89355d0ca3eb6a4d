"""A part of the logs as a design of its own: the same columns on some folds only."""

from collections.abc import Sequence

import numpy as np

from residual.effects.base import Effect, Joints, Shape
from residual.evidence.design import Design, Group
from residual.recording import Array


class Part(Design):
    """Some folds of a design.

    Columns are shared with the whole, and added to it. Residuals are those of all rows:
    they tell how long noise remembers, which is the same in every part.
    """

    def __init__(self, whole: Design, folds: Array) -> None:
        """Take the part.

        Args:
            whole: All logs.
            folds: Numbers of the folds that remain. Shape (k,).
        """
        self.__dict__.update(whole.__dict__)
        self._whole, self._kept = whole, folds
        self.folds = len(folds)
        self.power, self.tau_power = whole.power[folds], whole.tau_power[folds]
        self.rows = np.maximum(whole.fold_rows[folds].sum(axis=0), 1.0)
        self._sums = [None] * whole.dof

    def add(self, candidates: Sequence[tuple[Effect, Joints, Shape]]) -> list[Group]:
        """Append candidates to the whole, and return their groups."""
        made = self._whole.add(candidates)
        self.size = self._whole.size
        return made

    def columns(self, j: int, place: Array) -> Array:
        """Filtered columns of joint j, of the whole."""
        return self._whole.columns(j, place)

    def residual(self, j: int, ids: Array, theta: Array) -> Array:
        """What the columns leave of joint j's target, of the whole [N m]."""
        return self._whole.residual(j, ids, theta)

    def total(self, j: int, folds: Array | None = None) -> tuple[Array, Array]:
        """Gram and cross product of joint j, summed over folds of the part."""
        if folds is not None:
            return self._whole.total(j, self._kept[folds])
        if self._sums[j] is None or len(self._sums[j][1]) != self.cross[j].shape[1]:
            self._sums[j] = self._whole.total(j, self._kept)
        return self._sums[j]
