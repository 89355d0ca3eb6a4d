"""Columns of each joint on its rows, and their Gram matrices per fold.

Both grow, and all designs that share these columns see it. Only the newest columns, those
of tried shapes, may be removed.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.effects.base import Effect, Joints, PlacedEffect, Shape
from residual.recording import Array
from residual.signals.splitting import group_pieces_by_log
from residual.signals.track import Track


class ColumnCache:
    """Columns on the rows of each joint, with spare capacity."""

    def __init__(self) -> None:
        """Make an empty one."""
        self._kept: dict[int, tuple[Array, int]] = {}

    def copy(self) -> "ColumnCache":
        """Return a copy; later additions to one do not affect the other."""
        other = ColumnCache()
        other._kept = {j: (x[:n], n) for j, (x, n) in self._kept.items()}
        return other

    def write(self, j: int, columns: Array) -> None:
        """Append columns of joint j. Shape (k, rows)."""
        k, rows = columns.shape
        have, n = self._kept.get(j, (np.empty((0, rows)), 0))
        if n + k > len(have):
            # Many are added at once first, then a few at a time.
            longer = np.empty((n + k + (n + k) // 8 if n else k, rows))
            longer[:n] = have[:n]
            have = longer
        have[n : n + k] = columns
        self._kept[j] = have, n + k

    def cut(self, j: int, count: int) -> None:
        """Remove the newest columns of joint j, down to a number."""
        if j in self._kept:
            self._kept[j] = self._kept[j][0], count

    def count(self, j: int) -> int:
        """Return the number of columns of joint j."""
        return self._kept[j][1] if j in self._kept else 0

    def read(self, j: int, rows: int) -> Array:
        """Return all columns of joint j. Shape (k, rows)."""
        have, n = self._kept.get(j, (np.empty((0, rows)), 0))
        return have[:n]


class GramSums:
    """Gram matrices of appended columns, and their products with the target.

    Attributes:
        size: Number of columns.
        place: Per joint, index of each column among those that act on it, else -1.
            Shapes (size,).
        gram: Per joint, of all rows. Shapes (p, p).
        cross: Per joint, of every fold. Shapes (folds, p).
    """

    def __init__(self, dof: int, folds: int) -> None:
        """Create empty sums for a number of joints and folds."""
        self.size = 0
        self.place = [np.zeros(0, dtype=int) for _ in range(dof)]
        self.gram = [np.zeros((0, 0)) for _ in range(dof)]
        self.cross = [np.zeros((folds, 0)) for _ in range(dof)]
        self._room = list(zip(self.gram, self.cross, strict=True))

    def with_cross(self, cross: Sequence[Array]) -> "GramSums":
        """Return the same columns for another target, which may grow separately."""
        other = GramSums(len(cross), 0)
        other.size, other.place = self.size, list(self.place)
        other.gram, other.cross = list(self.gram), list(cross)
        other._room = list(zip(other.gram, other.cross, strict=True))
        return other

    def reserve(self, parts: Sequence[tuple[Joints, int]]) -> list[Array]:
        """Number new columns and reserve capacity."""
        ids, dof = [], len(self.place)
        have = [x.shape[1] for x in self.cross]
        for rows, k in parts:
            ids.append(np.arange(self.size, self.size + k))
            self.size += k
            for j in range(dof):
                own = np.full(k, -1)
                if j in rows:
                    own = np.arange(have[j], have[j] + k)
                    have[j] += k
                self.place[j] = np.concatenate([self.place[j], own])
        for j in range(dof):
            self.grow(j, have[j])
        return ids

    def grow(self, j: int, size: int) -> None:
        """Reserve capacity for columns on a joint."""
        old = self.cross[j].shape[1]
        gram, cross = self._room[j]
        if size > cross.shape[1]:
            folds, wide = len(cross), size + size // 8 if old else size
            larger = np.zeros((wide, wide)), np.zeros((folds, wide))
            larger[0][:old, :old], larger[1][:, :old] = self.gram[j], self.cross[j]
            self._room[j] = gram, cross = larger
        self.gram[j], self.cross[j] = gram[:size, :size], cross[:, :size]

    def cut(self, size: int) -> list[int]:
        """Remove the newest columns, down to a number."""
        self.size, counts = size, []
        for j, place in enumerate(self.place):
            self.place[j] = place[:size]
            n = int((self.place[j] >= 0).sum())
            gram, cross = self._room[j]
            gram[n:], gram[:, n:], cross[:, n:] = 0.0, 0.0, 0.0
            self.gram[j], self.cross[j] = gram[:n, :n], cross[:, :n]
            counts.append(n)
        return counts

    def add(self, j: int, columns: Array, first: int, y: Array, labels: Array) -> None:
        """Add rows to the sums of a joint's newest columns.

        Args:
            columns: All columns of the joint on these rows. Shape (p, rows).
            y: The target. Shape (rows,).
            labels: Fold of each row, in ascending order. Shape (rows,).
        """
        block = columns @ columns[first:].T
        self.gram[j][:, first:] += block
        self.gram[j][first:, :first] += block[:first].T
        for fold, own in slice_folds(labels):
            self.cross[j][fold, first:] += columns[first:, own] @ y[own]


class FoldGrams:
    """Gram matrices of requested columns of a joint in every fold.

    The leading columns, common to all fits, are stored completely; for others only their
    products with these, since a fit has few others.
    """

    def __init__(self, columns: ColumnCache, j: int, labels: Array, folds: int, lead: int) -> None:
        """Make empty ones.

        Args:
            labels: Fold of each row of joint j. Shape (rows,).
            lead: Number of leading columns.
        """
        self._columns, self._j, self._labels = columns, j, labels
        self._folds, self._lead = folds, np.arange(lead)
        self._whole: Array | None = None  # (folds, lead, lead)
        self._sides: dict[int, Array] = {}  # of a column with the leading ones

    def of(self, place: Array) -> Array:
        """Gram matrix of some columns, leading ones first. Shape (folds, k, k)."""
        lead, sides, others = self._parts(place)
        first, out = lead.shape[1], np.empty((self._folds, len(place), len(place)))
        out[:, :first, :first], out[:, first:, first:] = lead, others
        out[:, first:, :first], out[:, :first, first:] = sides, sides.mT
        return out

    def times(self, place: Array, theta: Array) -> Array:
        """Gram matrix of some columns times coefficients. Shape (folds, k)."""
        lead, sides, others = self._parts(place)
        first, last = np.split(theta, [lead.shape[1]])
        own = lead @ first + sides.mT @ last
        return np.concatenate([own, sides @ first + others @ last], axis=1)

    def _parts(self, place: Array) -> tuple[Array, Array, Array]:
        """Products of leading columns, of others with them, and of others."""
        if self._whole is None:
            self._whole = self._products(self._lead, self._lead)
        lead = self._lead[: len(place)]
        first = int(np.cumprod(place[: len(lead)] == lead).sum())
        others = place[first:]
        new = np.array([i for i in others if int(i) not in self._sides], dtype=int)
        if len(new):
            both = self._products(new, self._lead)
            self._sides |= {int(i): both[:, n] for n, i in enumerate(new)}
        sides = np.empty((self._folds, len(others), first))
        for n, i in enumerate(others):
            sides[:, n] = self._sides[int(i)][:, :first]
        among = self._products(others, others)
        return self._whole[:, :first, :first], sides, among

    def cut(self, size: int) -> None:
        """Remove columns from a number on."""
        self._sides = {i: x for i, x in self._sides.items() if i < size}

    def _products(self, left: Array, right: Array) -> Array:
        out = np.zeros((self._folds, len(left), len(right)))
        if not len(left):
            return out
        every = self._columns.read(self._j, len(self._labels))
        x, y = every[left], every[right]
        for fold, own in slice_folds(self._labels):
            out[fold] = x[:, own] @ y[:, own].T
        return out


@dataclass(frozen=True, eq=False, slots=True)
class CandidateColumns:
    """Columns added or dropped together: one candidate finding."""

    # Effect, joints (from 0) and shape.
    effect: Effect
    joints: Joints
    shape: Shape
    ids: Array  # their column numbers, (k,)
    precision: Array  # prior precision of their coefficients, (k, k)
    log_det: float  # log determinant of the precision
    # For one effect on all joints at once, the groups of the single joints.
    parts: tuple["CandidateColumns", ...] = ()
    fellows: int = 1  # number of groups in such a common group
    label: str = ""  # name of the candidate; the effect's own where empty
    # Known values of the coefficients, in addition to the typical prior.
    known_prior: "KnownPrior | None" = None

    @property
    def prior(self) -> "KnownPrior":
        """The parts of its prior other than the precision."""
        k = len(self.ids)
        nothing = np.zeros((k, k)), np.zeros(k), 0.0, self.log_det
        return self.known_prior or KnownPrior(*nothing)

    @property
    def placed(self) -> PlacedEffect:
        """The effect, joints and shape of its columns."""
        return PlacedEffect(self.effect, self.joints, self.shape)

    def scale_precision(self, times: float) -> "CandidateColumns":
        """Return the group with a scaled prior precision."""
        log_det = self.log_det + len(self.ids) * float(np.log(times))
        return replace(self, precision=times * self.precision, log_det=log_det)

    @property
    def key(self) -> tuple:
        """Identity without the shape: one candidate finding per key."""
        fixed = self.shape if self.effect.refine is None else ()
        return (self.label or self.effect.name, self.joints, fixed)


@dataclass(frozen=True, eq=False, slots=True)
class KnownPrior:
    """A prior with known values: (theta - mu)'(P + K)(theta - mu)."""

    information: Array  # K, added to the typical precision P, (k, k)
    pull: Array  # (P + K) mu, (k,)
    level: float  # mu'(P + K) mu
    log_det: float  # of P + K

    @classmethod
    def of(cls, precision: Array, information: Array, pull: Array) -> "KnownPrior":
        """Known values, for an effect with the typical prior."""
        both = precision + information
        return cls(
            information,
            pull,
            float(pull @ np.linalg.solve(both, pull)),
            float(np.linalg.slogdet(both)[1]),
        )


def regularize_precision(precision: Array) -> tuple[Array, float]:
    """An invertible precision, and its log determinant. (k, k) as given."""
    scale = np.sqrt(np.maximum(np.diag(precision), 1e-12))
    precision = precision + 1e-6 * np.diag(scale**2)
    log_det = 2 * np.log(scale).sum()
    log_det += np.linalg.slogdet(precision / np.outer(scale, scale))[1]
    return precision, float(log_det)


def merge_groups(parts: Sequence[CandidateColumns], label: str = "") -> CandidateColumns:
    """One candidate of several groups, such as an effect on all joints."""
    parts = [replace(g, fellows=len(parts)) for g in parts]
    sizes = [len(g.ids) for g in parts]
    precision = np.zeros((sum(sizes), sum(sizes)))
    start = 0
    for g, k in zip(parts, sizes, strict=True):
        precision[start : start + k, start : start + k] = g.precision
        start += k
    return CandidateColumns(
        effect=parts[0].effect,
        joints=tuple(sorted({j for g in parts for j in g.joints})),
        shape=parts[0].shape,
        ids=np.concatenate([g.ids for g in parts]),
        precision=precision,
        log_det=sum(g.log_det for g in parts),
        parts=tuple(parts),
        label=label,
    )


BLOCKS_OF_ONE_LOG, BLOCKS_OF_A_LOG, ENOUGH_LOGS = 6, 3, 4


def label_folds(tracks: Sequence[Track]) -> list[Array]:
    """Fold of each row of the logs: a log, or blocks of it if logs are few."""
    logs, blocks = group_pieces_by_log([track.id for track in tracks]), 1
    if len(logs) < ENOUGH_LOGS:
        blocks = BLOCKS_OF_ONE_LOG if len(logs) == 1 else BLOCKS_OF_A_LOG
    out = []
    for k, pieces in enumerate(logs):
        for i, number in enumerate(pieces):
            m = len(tracks[number].tau)
            # A piece of a log lies within one block (`split_long_logs`).
            within = (np.arange(m) if len(pieces) == 1 else np.full(m, i)) * blocks
            out.append(k * blocks + within // (m if len(pieces) == 1 else len(pieces)))
    return out


def select_moving_rows(tracks: Sequence[Track]) -> list[Array]:
    """Rows on which each joint moves, in logs with torque. Shapes (m, dof)."""
    out = []
    for pieces in group_pieces_by_log([t.id for t in tracks]):
        own = [tracks[i] for i in pieces]
        alive = np.any([np.ptp(t.tau, axis=0) > 0 for t in own], axis=0)
        out += [t.moving & alive for t in own]
    return out


def sum_squares_per_fold(values: Sequence[Array], labels: Sequence[Array], folds: int) -> Array:
    """Sum of squares per fold and joint, of rows and folds. Shape (folds, dof)."""
    pairs = zip(labels, values, strict=True)
    sums = [np.bincount(own, x**2, minlength=folds) for own, x in pairs]
    return np.stack(sums, axis=1)


def slice_folds(labels: Array) -> Iterator[tuple[int, slice]]:
    """Folds of rows with their slices of consecutive rows."""
    folds, starts = np.unique(labels, return_index=True)
    counts = np.bincount(labels)[folds]
    for fold, start, count in zip(folds, starts, counts, strict=True):
        yield int(fold), slice(int(start), int(start + count))
