"""Rows of columns by shelf, and their Gram matrices per joint and fold.

Both are appended to, and all designs that share these columns see it. Only the newest
columns may be taken back, those of shapes that were tried.
"""

import os
from collections.abc import Sequence
from tempfile import TemporaryFile

import numpy as np

from residual.effects.base import Joints
from residual.recording import Array


class ColumnCache:
    """Columns on the rows of each shelf, in memory or in a file without a name.

    The file is the one place where the core touches a disk. It is memory that happens
    to lie there, as the system's own swap does: no path comes in or goes out, nothing
    is left of it, and a result does not depend on it. It vanishes with the last use of
    this object, and lies where the system keeps such files (TMPDIR).
    """

    def __init__(self, on_disk: bool) -> None:
        """Make an empty one."""
        # It is closed with this object.
        self._file = TemporaryFile(prefix="modelgap-") if on_disk else None  # noqa: SIM115
        self._kept: dict[object, tuple[Array, int]] = {}
        self._blocks: dict[object, list[tuple[int, int]]] = {}
        self._end = 0

    def copy(self) -> "ColumnCache":
        """The same columns; what is added to one does not show in the other."""
        other = ColumnCache(False)
        other._kept = {k: (x[:n], n) for k, (x, n) in self._kept.items()}
        other._file, other._end = self._file, self._end
        other._blocks = {k: list(blocks) for k, blocks in self._blocks.items()}
        return other

    def write(self, shelf: object, columns: Array) -> None:
        """Append columns to a shelf.

        Args:
            shelf: Its name; as many rows on each shelf at any time.
            columns: Shape (k, rows).
        """
        if self._file is None:
            self._keep(shelf, columns)
            return
        data = np.ascontiguousarray(columns)
        self._blocks.setdefault(shelf, []).append((self._end, len(data)))
        os.pwrite(self._file.fileno(), data, self._end) if data.size else None
        self._end += data.nbytes

    def _keep(self, shelf: object, columns: Array) -> None:
        k, rows = columns.shape
        have, n = self._kept.get(shelf, (np.empty((0, rows)), 0))
        if n + k > len(have):
            # Many are added at once first, then a few at a time.
            longer = np.empty((n + k + (n + k) // 8 if n else k, rows))
            longer[:n] = have[:n]
            have = longer
        have[n : n + k] = columns
        self._kept[shelf] = have, n + k

    def cut(self, shelf: object, count: int) -> None:
        """Take back the newest columns of a shelf, so that so many are left."""
        if shelf in self._kept:
            self._kept[shelf] = self._kept[shelf][0], count
        blocks, have = [], 0
        for offset, k in self._blocks.get(shelf, []):
            blocks += [(offset, min(k, count - have))] if count > have else []
            have += k
        self._blocks[shelf] = blocks

    def count(self, shelf: object) -> int:
        """Return the number of columns on a shelf."""
        if self._file is None:
            return self._kept[shelf][1] if shelf in self._kept else 0
        return sum(k for _, k in self._blocks.get(shelf, []))

    def read(self, shelf: object, rows: int) -> Array:
        """Return all columns of a shelf. Shape (k, rows)."""
        if self._file is None:
            have, n = self._kept.get(shelf, (np.empty((0, rows)), 0))
            return have[:n]
        blocks = self._blocks.get(shelf, [])
        out = np.empty((sum(k for _, k in blocks), rows))
        start = 0
        for offset, k in blocks:
            part = out[start : start + k]
            if part.size:
                os.preadv(self._file.fileno(), [part], offset)
            start += k
        return out


class Sums:
    """Gram matrices of appended columns, and their products with the target.

    Attributes:
        size: Number of columns.
        place: Per joint, where each column stands among those that act on it; -1 where
            it does not. Shapes (size,).
        gram, cross: Per joint. Shapes (folds, p, p), (folds, p).
    """

    def __init__(self, dof: int, folds: int) -> None:
        """Make empty sums of so many joints and folds."""
        self.size = 0
        self.place = [np.zeros(0, dtype=int) for _ in range(dof)]
        self.gram = [np.zeros((folds, 0, 0)) for _ in range(dof)]
        self.cross = [np.zeros((folds, 0)) for _ in range(dof)]
        self._room = list(zip(self.gram, self.cross, strict=True))

    def with_cross(self, cross: Sequence[Array]) -> "Sums":
        """The same columns, that may grow on their own, for another target."""
        other = Sums(len(cross), 0)
        other.size, other.place = self.size, list(self.place)
        other.gram, other.cross = list(self.gram), list(cross)
        other._room = list(zip(other.gram, other.cross, strict=True))
        return other

    def reserve(self, parts: Sequence[tuple[Joints, int]]) -> list[Array]:
        """Number new columns and make room for them."""
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
        """Make room for so many columns on a joint."""
        old = self.cross[j].shape[1]
        gram, cross = self._room[j]
        if size > cross.shape[1]:
            folds, wide = len(cross), size + size // 8 if old else size
            larger = np.zeros((folds, wide, wide)), np.zeros((folds, wide))
            larger[0][:, :old, :old], larger[1][:, :old] = self.gram[j], self.cross[j]
            self._room[j] = gram, cross = larger
        self.gram[j], self.cross[j] = gram[:, :size, :size], cross[:, :size]

    def cut(self, size: int) -> list[int]:
        """Take back the newest columns, so that so many are left."""
        self.size, counts = size, []
        for j, place in enumerate(self.place):
            self.place[j] = place[:size]
            n = int((self.place[j] >= 0).sum())
            gram, cross = self._room[j]
            gram[:, n:], gram[:, :, n:], cross[:, n:] = 0.0, 0.0, 0.0
            self.gram[j], self.cross[j] = gram[:, :n, :n], cross[:, :n]
            counts.append(n)
        return counts

    def add(self, j: int, fold: int, rows: Array, first: int, y: Array) -> None:
        """Add rows of one fold to the sums of a joint's newest columns.

        Args:
            rows: All columns of the joint on these rows. Shape (p, rows).
            y: The target. Shape (rows,).
        """
        block = rows @ rows[first:].T
        self.gram[j][fold, :, first:] += block
        self.gram[j][fold, first:, :first] += block[:first].T
        self.cross[j][fold, first:] += rows[first:] @ y
