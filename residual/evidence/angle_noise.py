"""The bias by noise of the angles in products of columns with the torque.

Columns X are made of measured angles. For a model b of the torque X b the noise N in
X'X gives X' (tau - X b) = -N b without a missing effect, and least squares turns it into
an effect. A second, redrawn noise of the measured level shifts columns and torque of the
model again; the products of the shifts are N b. Only a missing effect stays too small by
N: its size is corrected later (``diagnosis.errors_in_variables``).

A drive that computes the torque from the same angles shifts it too, by G: the bias is
then -(N b - X'G). The scatter about the model b is noise in any case, so a fit lowers the
squared error by 2 (theta - b)' (N b - X'G): zero at b itself.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from residual.recording import Array
from residual.signals.track import Track


class AngleNoise:
    """The shifts by the noise in the columns of each joint, and in the torque."""

    def __init__(self, dof: int, tracks: Mapping[int, Track]) -> None:
        """Take the logs, by number, with redrawn noise."""
        self.tracks = tracks
        self._moved: dict[tuple[int, int], Array] = {}  # by log and joint, (k, rows)
        self._first: dict[int, Sequence[Array]] = {}
        self._torque: dict[int, Sequence[Array]] = {}
        self._surplus: dict[int, Array] = {}  # by log, (dof,)
        self._pulls: list[Array] = [np.zeros(0)] * dof

    def take_torque(self, i: int, moved: Sequence[Array], driven: Sequence[Array]) -> None:
        """Set the shift by the noise in the torque of each joint of a log. Shapes (rows,).

        Args:
            moved: Shift of the model torque; on the first call of the nominal one.
            driven: Shift of the logged torque, if a drive computes it.
        """
        first = self._first.setdefault(i, moved)
        left = [m - d for m, d in zip(moved, driven, strict=True)]
        self._torque[i] = left
        pairs = zip(moved, first, left, strict=True)
        self._surplus[i] = np.array([2 * (m - f) @ x for m, f, x in pairs])
        self._pulls = [np.zeros(0)] * len(self._pulls)

    def surplus(self) -> Array:
        """Fall of the squared error of the model by the bias, per row. (dof,)."""
        rows = sum(np.array([len(x) for x in own]) for own in self._torque.values())
        return sum(self._surplus.values()) / np.maximum(rows, 1)

    def extend(self, i: int, j: int, moved: Array) -> None:
        """Append the shifts of new columns. Shape (k, rows)."""
        have = self._moved.get((i, j))
        self._moved[i, j] = moved if have is None else np.concatenate([have, moved])

    def cut(self, j: int, count: int) -> None:
        """Remove the newest columns of a joint, down to a number."""
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
