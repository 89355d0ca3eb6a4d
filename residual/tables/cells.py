"""Rows of equal levels merged into weighted cells, which loses nothing.

A fit to indicators of levels sees of a row only its levels: rows that share all of them
count as one with their number as weight and the sum of their responses. A log of a
repeated or slow motion shrinks tenfold.
"""

from dataclasses import dataclass
from math import prod

import numpy as np

from residual.recording import Array
from residual.tables.blocks import frozen
from residual.tables.levels import Codes


@dataclass(frozen=True, eq=False, slots=True)
class Cells:
    """Distinct combinations of levels.

    Attributes:
        codes: Levels of each cell, in ascending order of rows; uint16. Shape (c, d).
        sizes: Number of levels of each variable. Shape (d,).
        count: Rows in each cell. Shape (c,).
        of_row: Cell of each row. Shape (n,).
    """

    codes: Array
    sizes: Array
    count: Array
    of_row: Array

    @property
    def pair_columns(self) -> int:
        """Columns that all products of two variables' indicators would take."""
        return int(self.sizes.sum() ** 2 - (self.sizes**2).sum()) // 2

    def sums(self, Y: Array) -> Array:
        """Sum of each column over the rows of each cell. Shape (c, j)."""
        columns = [np.bincount(self.of_row, y, len(self.count)) for y in Y.T]
        return np.stack(columns, axis=1)


def merge_rows(codes: Codes) -> Cells:
    """Merge rows that have all levels in common.

    Args:
        codes: Levels of the rows.

    Returns:
        The cells; neighbours share their first variables, so that tables that are
        read one after the other lie close in memory.
    """
    key = _keys(codes)
    _, first, of_row, count = np.unique(
        key, return_index=True, return_inverse=True, return_counts=True
    )
    return Cells(
        frozen(np.ascontiguousarray(codes.values[first], dtype=np.uint16)),
        frozen(np.array(codes.sizes, dtype=np.int64)),
        frozen(count.astype(float)),
        frozen(of_row.reshape(-1)),
    )


def _keys(codes: Codes) -> Array:
    """One number per row where they fit into 64 bits, else the bytes of the row."""
    if prod(codes.sizes) < 2**63:
        key = np.zeros(len(codes.values), np.int64)
        for column, size in zip(codes.values.T, codes.sizes, strict=True):
            key *= size
            key += column
        return key
    wide = np.ascontiguousarray(codes.values.astype(">u2"))
    return wide.view(np.dtype((np.void, 2 * wide.shape[1]))).ravel()
