"""Nominal levels: each variable replaced by the number of the interval it is in.

Section 2.6.1 of the paper makes a column of zeros and ones of each level; the number
of the level says the same in one byte.

A fit to indicators of levels sees of a row only its levels: rows that share all of them
count as one with their number as weight and the sum of their responses. A log of a
repeated or slow motion shrinks tenfold.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from math import prod
from typing import NamedTuple

import numpy as np

from residual.errors import InputError
from residual.quantity import (
    as_block,
    as_names,
    as_rows,
    check_count,
    check_varying,
    frozen,
)
from residual.recording import Array

MOST = 4096  # levels of one variable; no encoder of ours resolves more in a log
DWELL = 1e-3  # rad/s: a joint slower than this stands still


@dataclass(frozen=True, eq=False, slots=True)
class Levels:
    """Intervals of each variable, with the range that they were made for."""

    names: tuple[str, ...]
    # Inner edges of each variable, increasing; a value at an edge belongs above it. One
    # shape (levels - 1,) per variable.
    edges: tuple[Array, ...]
    # Calibrated range, (d,).
    low: Array
    high: Array

    @property
    def sizes(self) -> tuple[int, ...]:
        """Number of levels of each variable."""
        return tuple(len(edges) + 1 for edges in self.edges)

    def encode(self, X: Array) -> "Codes":
        """Return the level of every value; the outermost reach to infinity. (n, d)."""
        X = as_rows(X, self.names, "the levels are of")
        kind = np.uint8 if max(self.sizes) <= 256 else np.uint16
        codes = np.empty(X.shape, kind)
        for i, edges in enumerate(self.edges):
            codes[:, i] = np.searchsorted(edges, X[:, i], side="right")
        return Codes(frozen(codes), self.sizes)


class Codes(NamedTuple):
    """Level of each value of rows, from 0, and the number of levels of each variable.

    Levels are uint8, or uint16 beyond 256. Shape (n, d).
    """

    values: Array
    sizes: tuple[int, ...]


Count = int | Sequence[int]  # levels of all variables, or of each


def equal_levels(X: Array, count: Count, names: Sequence[str] | None = None) -> Levels:
    """Equally wide levels over the range of each variable (paper, section 2.6.1).

    Count is of levels of all variables, or of each, at least 2.
    """
    X, names, counts = _checked(X, count, names)
    spans = zip(X.min(axis=0), X.max(axis=0), counts, strict=True)
    return _levels_of(
        X, names, [a + (b - a) * np.arange(1, k) / k for a, b, k in spans]
    )


def quantile_levels(
    X: Array,
    count: Count,
    names: Sequence[str] | None = None,
    *,
    velocities: Collection[int] = (),
    constant: bool = False,
) -> Levels:
    """Levels that hold about equally many calibration rows each.

    Equal edges, which many equal values make, are merged, so a variable may get fewer
    levels. Velocities that go both ways get a level of standing still and half of the
    levels on either side: friction jumps there, and a level that straddles zero cannot
    tell one side from the other.

    Args:
        velocities: Columns (from 0) that hold velocities [rad/s].
        constant: Whether a column may be constant; all of it is then in one level.
    """
    X, names, counts = _checked(X, count, names, constant)
    edges = [
        _around_zero(column, k) if i in velocities else _quantiles(column, k)
        for i, (column, k) in enumerate(zip(X.T, counts, strict=True))
    ]
    return _levels_of(X, names, edges)


def _levels_of(X: Array, names: tuple[str, ...], edges: Sequence[Array]) -> Levels:
    low, high = frozen(X.min(axis=0)), frozen(X.max(axis=0))
    return Levels(names, tuple(map(frozen, edges)), low, high)


def _checked(
    X: Array, count: Count, names: Sequence[str] | None, constant: bool = False
) -> tuple:
    X = as_block(X, "X")
    names = as_names(names, X.shape[1], "x")
    counts = list(count) if isinstance(count, Sequence) else [count] * len(names)
    if len(counts) != len(names):
        raise InputError(
            f"levels are of {len(counts)} variables, the rows of {len(names)}: give "
            "one number for all, or one for each."
        )
    for levels in counts:
        check_count(
            levels, 2, MOST, "levels", "One level cannot tell two states apart."
        )
    if not constant:
        check_varying(X, names)
    return X, names, counts


def _quantiles(x: Array, count: int) -> Array:
    edges = np.unique(np.quantile(x, np.arange(1, count) / count))
    # An edge at the smallest value would leave the level below it empty.
    return edges[edges > x.min()] if (edges > x.min()).any() else x.max(keepdims=True)


def _around_zero(x: Array, count: int) -> Array:
    behind, ahead = x[x < -DWELL], x[x > DWELL]
    if not len(behind) or not len(ahead):
        return _quantiles(x, count)
    half = max(count // 2, 1)
    inner = np.arange(1, half) / half
    sides = np.quantile(behind, inner), [-DWELL, DWELL], np.quantile(ahead, inner)
    return np.unique(np.concatenate(sides))


@dataclass(frozen=True, eq=False, slots=True)
class Cells:
    """Distinct combinations of levels."""

    codes: Array  # levels of each cell, in ascending order of rows; uint16, (c, d)
    sizes: Array  # number of levels of each variable, (d,)
    count: Array  # rows in each cell, (c,)
    of_row: Array  # cell of each row, (n,)

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

    Neighbours share their first variables, so that tables that are read one after the
    other lie close in memory.
    """
    if prod(codes.sizes) < 2**63:  # one number per row, else the bytes of the row
        key = np.zeros(len(codes.values), np.int64)
        for column, size in zip(codes.values.T, codes.sizes, strict=True):
            key *= size
            key += column
    else:
        wide = np.ascontiguousarray(codes.values.astype(">u2"))
        key = wide.view(np.dtype((np.void, 2 * wide.shape[1]))).ravel()
    _, first, of_row, count = np.unique(
        key, return_index=True, return_inverse=True, return_counts=True
    )
    return Cells(
        frozen(np.ascontiguousarray(codes.values[first], dtype=np.uint16)),
        frozen(np.array(codes.sizes, dtype=np.int64)),
        frozen(count.astype(float)),
        frozen(of_row.reshape(-1)),
    )
