"""The bias that noise of the angles is to products of columns with the torque.

Columns X are made of measured angles. For a model b of the torque X b the noise N in
X'X leaves X' (tau - X b) = -N b where nothing is missing, and least squares makes an
effect of it. One more helping of the noise, as it was measured, moves columns and
torque of the model once more; their products are N b. Only what is missing stays too
small by N: that is a matter of its size (``diagnosis.errors_in_variables``).

A drive that computes the torque by the same angles moves that as well, by G: least
squares leaves -(N b - X'G). What scatters about the model b is noise all the same, so
that a fit has less squared error by 2 (theta - b)' (N b - X'G): nothing at b itself.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from residual.recording import Array
from residual.signals.track import Track


class AngleNoise:
    """What the noise moves in the columns of each joint, and in the torque."""

    def __init__(self, dof: int, tracks: Mapping[int, Track]) -> None:
        """Take the logs, by number, with one more helping of noise."""
        self.tracks = tracks
        self._moved: dict[tuple[int, int], Array] = {}  # by log and joint, (k, rows)
        self._first: dict[int, Sequence[Array]] = {}
        self._torque: dict[int, Sequence[Array]] = {}
        self._surplus: dict[int, Array] = {}  # by log, (dof,)
        self._pulls: list[Array] = [np.zeros(0)] * dof

    def take_torque(self, i: int, moved: Sequence[Array], driven: Sequence[Array]) -> None:
        """What the noise moves in the torque of each joint of a log. Shapes (rows,).

        Args:
            moved: Of the model; the first time that is the nominal one.
            driven: Of the logged torque: something where a drive computes it.
        """
        first = self._first.setdefault(i, moved)
        left = [m - d for m, d in zip(moved, driven, strict=True)]
        self._torque[i] = left
        pairs = zip(moved, first, left, strict=True)
        self._surplus[i] = np.array([2 * (m - f) @ x for m, f, x in pairs])
        self._pulls = [np.zeros(0)] * len(self._pulls)

    def surplus(self) -> Array:
        """What pulls would take from the squared error of the model, by row. (dof,)."""
        rows = sum(np.array([len(x) for x in own]) for own in self._torque.values())
        return sum(self._surplus.values()) / np.maximum(rows, 1)

    def extend(self, i: int, j: int, moved: Array) -> None:
        """Append what it moves in new columns. Shape (k, rows)."""
        have = self._moved.get((i, j))
        self._moved[i, j] = moved if have is None else np.concatenate([have, moved])

    def cut(self, j: int, count: int) -> None:
        """Forget the newest columns of a joint, so that so many are left."""
        for key in self._moved:
            if key[1] == j:
                self._moved[key] = self._moved[key][:count]
        self._pulls[j] = self._pulls[j][:count]

    def pull(self, j: int) -> Array:
        """Bias of the product of each column with the target, by row. Shape (k,)."""
        logs = [i for i in self.tracks if (i, j) in self._moved]
        have = len(self._pulls[j])
        if logs and len(self._moved[logs[0], j]) > have:
            new = sum(self._moved[i, j][have:] @ self._torque[i][j] for i in logs)
            rows = sum(len(self._torque[i][j]) for i in logs)
            self._pulls[j] = np.concatenate([self._pulls[j], new / max(rows, 1)])
        return self._pulls[j]
