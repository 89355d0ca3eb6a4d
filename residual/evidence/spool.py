"""Columns that are too many to be kept in memory, in a file without a name."""

import os
from tempfile import TemporaryFile

import numpy as np

from residual.recording import Array


class Spool:
    """Blocks of columns by shelf, written once and read in the order of writing.

    The one place of the core that touches a disk. It is memory that happens to lie
    there, as the system's own swap does: no path comes in or goes out, nobody else can
    open the file, nothing is left of it, and a result does not depend on it. Made in
    here, since which columns a search adds is known to the search alone. It vanishes
    with the last use of this object, and lies where the system keeps such files
    (TMPDIR).
    """

    def __init__(self) -> None:
        # It is closed with this object.
        self._file = TemporaryFile(prefix="modelgap-")  # noqa: SIM115
        self._blocks: dict[object, list[tuple[int, int]]] = {}
        self._end = 0

    def write(self, shelf: object, columns: Array) -> None:
        """Append columns to a shelf.

        Args:
            shelf: Its name; as many rows on each shelf at any time.
            columns: Shape (rows, k).
        """
        data = np.ascontiguousarray(columns.T)
        self._blocks.setdefault(shelf, []).append((self._end, len(data)))
        os.pwrite(self._file.fileno(), data, self._end) if data.size else None
        self._end += data.nbytes

    def read(self, shelf: object, rows: int) -> Array:
        """Return all columns of a shelf, transposed. Shape (columns, rows)."""
        blocks = self._blocks.get(shelf, [])
        out = np.empty((sum(k for _, k in blocks), rows))
        start = 0
        for offset, k in blocks:
            part = out[start : start + k]
            if part.size:
                os.preadv(self._file.fileno(), [part], offset)
            start += k
        return out
