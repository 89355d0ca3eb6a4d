"""Rows of two epochs as one design: shared columns are noise, a change is a column.

The rows of joint j are y = M beta + 1[second] Z theta + e. M, the small effects of any arm
and the differences between its logs, is shared by both epochs with a prior of typical
sizes: with beta ~ N(0, L^-1) the rows have the covariance s^2 (I + M L^-1 M'), and rows
times its inverse root are independent (generalized least squares). The part of a
candidate that may have been present before is projected out.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from residual.effects.base import Joints, MotionSpan
from residual.evidence.angle_noise import AngleNoise
from residual.evidence.columns import CandidateColumns, ColumnCache, GramSums, sum_squares_per_fold
from residual.evidence.design import Design
from residual.evidence.thresholds import THRESHOLDS
from residual.recording import Array

OWN = 1e-3  # of a column's square: less means that it was present before


@dataclass(frozen=True, eq=False, slots=True)
class Whitening:
    """The inverse root of the covariance of one joint's rows, of unit noise."""

    basis: Array  # orthonormal shared columns, (rows, k)
    shrink: Array  # removed share of each, (k,)
    weight: Array | float  # of the rows: the typical deviation over theirs, (rows,)

    @classmethod
    def of(cls, shared: Array, precision: Array, weight: Array | float = 1.0) -> "Whitening":
        """Columns with a prior precision, in units of the noise. (rows, p), (p,)."""
        shared = (weight * shared.T).T
        size = np.sqrt((shared**2).mean(axis=0)) if len(shared) else np.zeros(0)
        real = size > 1e-9 * size.max(initial=1e-30)
        scaled = shared[:, real] / np.sqrt(precision[real])
        basis, size, _ = np.linalg.svd(scaled, full_matrices=False)
        return cls(basis, 1 - 1 / np.sqrt(1 + size**2), weight)

    @property
    def degrees(self) -> float:
        """Degrees of freedom of the shared columns."""
        return float((1 - (1 - self.shrink) ** 2).sum())

    def __call__(self, rows: Array) -> Array:
        """Whiten row values. Shape (..., rows)."""
        rows = self.weight * rows
        return rows - ((rows @ self.basis) * self.shrink) @ self.basis.T


@dataclass(frozen=True, eq=False, slots=True)
class EpochRows:
    """The origin of the rows of one joint."""

    second: Array  # they are of the second epoch. Shape (rows,), bool
    log: Array  # number of the log, (rows,)
    block: Array  # number of the block, ascending, (rows,)

    @property
    def compared(self) -> bool:
        """Whether both epochs have enough rows."""
        fewer = min(self.second.sum(), (~self.second).sum())
        return bool(fewer > THRESHOLDS.min_epoch_rows)


def locate_rows(design: Design, first: int) -> list[EpochRows]:
    """Rows of each joint, given the number of logs of the first epoch."""
    number = [np.full((len(t.tau), design.dof), i) for i, t in enumerate(design.tracks)]
    return [
        EpochRows(log >= first, log, design.label_joint_folds(j))
        for j, log in enumerate(design.stacked(number))
    ]


class EpochDesign(Design):
    """Whitened rows of both epochs; candidates act in the second only.

    Its nominal model is one column: the friction of all joints in the second epoch,
    which temperature scales together.

    Attributes:
        raw: The design of the same logs without whitening.
        epochs: Where the rows of each joint come from.
        whiten: The whitening of each compared joint.
    """

    @classmethod
    def of(
        cls,
        raw: Design,
        target: Sequence[Array],
        friction: Sequence[Array],
        whiten: Mapping[int, Whitening],
        epochs: Sequence[EpochRows],
        span: MotionSpan,
    ) -> "EpochDesign":
        """Whiten a design of the logs of both epochs.

        Args:
            target: Residual of one arm fitted to both epochs [N m]. Shapes (rows,).
            friction: Torque of all its friction [N m]. Shapes (rows,).
            whiten: Whitening of each compared joint.
        """
        out = cls.__new__(cls)
        out.__dict__.update(raw.__dict__)
        out.raw, out.epochs, out.whiten, out._span = raw, epochs, whiten, span
        out._information, out._acting = {}, {}
        out._columns, out._sums = ColumnCache(), GramSums(out.dof, out.folds)
        out._before = ColumnCache()
        out._totals, out._lines = [None] * out.dof, {}
        out.flat, out.stacks, out._noise = {}, {}, AngleNoise(out.dof, {})
        out.unrest = np.ones(out.dof)
        out.target = [out._whitened(j, y) for j, y in enumerate(target)]
        out._squares = sum_squares_per_fold(out.target, [own.block for own in epochs], out.folds)
        out.rows = np.ones(out.dof)
        for j, own in whiten.items():
            out.rows[j] = max(len(epochs[j].block) - own.degrees, 1.0)
        (out.nominal,) = out._sums.reserve([(tuple(range(out.dof)), 1)])
        out.inertial = out.nominal[:0]
        for j, (own, torque) in enumerate(zip(epochs, friction, strict=True)):
            moved = out._whitened(j, torque * own.second)[None]
            out._store(j, moved, np.zeros_like(moved))
        out._blocks = [out._fold_grams(j) for j in range(out.dof)]
        return out

    def _whitened(self, j: int, rows: Array) -> Array:
        """Whiten rows; a joint that is not compared has none."""
        whiten = self.whiten.get(j)
        return np.zeros_like(rows) if whiten is None else whiten(rows)

    def _store(self, j: int, columns: Array, before: Array) -> None:
        self._before.write(j, before.astype(np.float32))
        super()._extend(j, columns, ())

    def _extend(self, j: int, new: Array, widths: Sequence[int]) -> None:
        second, start = self.epochs[j].second, self._columns.count(j)
        after, every = self._whitened(j, new * second), self._whitened(j, new)
        power, count = (new**2).sum(axis=1), max(int(second.sum()), 1)
        rms = np.sqrt((self.tau[j][second] ** 2).sum() / count) or self.rms[j]
        for a, b in pairwise(np.cumsum([0, *widths])):
            before, acting = every[a:b], new[a:b, second]
            gram = before @ before.T + np.diag(OWN * power[a:b] + 1e-300)
            after[a:b] -= np.linalg.solve(gram, before @ after[a:b].T).T @ before
            self._information[j, start + a] = acting @ acting.T / count / rms**2
        self._store(j, after, every)

    def drop_newest_columns(self, size: int) -> None:
        """Forget the columns that were added since there were ``size`` of them."""
        super().drop_newest_columns(size)
        for j in range(self.dof):
            self._before.cut(j, self._columns.count(j))

    def fold_pulls(self, j: int, place: Array, theta: Array) -> Array:
        """Products of columns with their residual, in every fold. Shape (folds, k).

        The residual of a change also excludes the same effect in both epochs, which is
        orthogonal to it over all blocks, but not in a single one.
        """
        pulls, rows = super().fold_pulls(j, place, theta), len(self.target[j])
        before = self._before.read(j, rows)[place].astype(float)
        columns = self.columns(j, place).T
        gram = before @ before.T
        gram += np.diag(OWN * np.diag(gram) + 1e-300)
        left = self.target[j] - theta @ columns
        again = columns * (np.linalg.solve(gram, before @ left) @ before)
        out = np.zeros((self.raw.folds, len(place)))
        np.add.at(out, self.epochs[j].block, again.T)
        return pulls - (out if self._kept is None else out[self._kept])

    def unit_information(self, ids: Array, rows: Joints) -> Array:
        """Mean square of the columns in the second epoch, of torque rms. (k, k)."""
        out = np.zeros((len(ids), len(ids)))
        for j in rows:
            place, have = self.present(j, ids)
            out[np.ix_(have, have)] += self._information[j, int(place[0])]
        return out

    def _group(self, candidate, rows: Joints, ids: Array) -> CandidateColumns:
        """Return a group; an added load may be several times the typical one."""
        group = super()._group(candidate, rows, ids)
        usual = group.effect.prior_sd is None
        return group if usual else group.scale_precision(THRESHOLDS.load_precision)

    def coefficients(self, theta: Array) -> Array:
        """The nominal coefficients, which a fit does not change."""
        return self.model.coefficients()

    def may_fall(self, group: CandidateColumns) -> bool:
        """Whether it may fall: a load may be removed, and small effects may shrink."""
        anchor = group.joints[0] if group.joints else 0
        usual = group.effect.in_any_arm(self._span, anchor)
        return group.effect.scope == "flange" or bool(usual)

    def acting(self, j: int) -> Array:
        """Rows of the second epoch. Shape (rows,), bool."""
        return self.epochs[j].second

    def torque(self, group: CandidateColumns, theta: Array, j: int) -> Array:
        """Torque of a change on the rows of the second epoch [N m]. (n,)."""
        key = group.effect.name, group.joints, group.shape
        if key not in self._acting:
            (self._acting[key],) = self.raw.add([group.placed])
        return self.raw.torque(self._acting[key], theta, j)[self.acting(j)]

    def torque_shares(self, group: CandidateColumns, theta: Array) -> Array:
        """Rms torque of a change, as a share of the second epoch's. Shape (dof,)."""
        out = np.zeros(self.dof)
        for j in range(self.dof):
            torque, logged = self.torque(group, theta, j), self.tau[j][self.acting(j)]
            if torque.any():
                out[j] = np.sqrt((torque**2).mean() / max((logged**2).mean(), 1e-18))
        return out
