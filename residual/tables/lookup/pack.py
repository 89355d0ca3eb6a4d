"""Axes and tables of a look-up, laid out for fast reading.

Three pair tables over the same three axes are one table of three axes: their sum. Nine
variables have 36 pairs, and twelve triples hold each of them once (a Steiner system):
a row takes 12 reads and not 36.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import prod

import numpy as np

from residual.recording import Array


@dataclass(frozen=True, eq=False, slots=True)
class Axis:
    """Levels of one variable.

    Attributes:
        variable: Column of X, from 0.
        edges: Inner edges, increasing; a value at one belongs above. Shape (k - 1,).
    """

    variable: int
    edges: Array


@dataclass(frozen=True, eq=False, slots=True)
class Table:
    """Corrections by the levels of one axis or two.

    Attributes:
        axes: Numbers of its axes.
        values: Shape (k, j) or (k1, k2, j), in units of the responses.
    """

    axes: tuple[int, ...]
    values: Array


GRID = 1024  # steps per axis that lead to a level without a search
CUBE = 32_768  # cells that a table of three axes may have: 1 MB for four joints
TRIES = 2_000  # steps of the search for triples: plenty for 9 axes

Pieces = tuple[Array, Array]
Pair = tuple[int, int]
Tables = dict[tuple[int, ...], Array]


def pack(
    axes: Sequence[Axis], tables: Sequence[Table], linear: Pieces, span: Pieces
) -> tuple[Array, ...]:
    """Return the arrays that the compiled evaluation reads.

    Args:
        linear: Offset and slope of the linear part. Shapes (j,), (d, j).
        span: Lowest and highest calibrated value of each variable. Shapes (d,).

    Returns:
        axes (a, 2): variable and place of the first edge; grid (a, 2): lowest value
        and steps per unit; starts (a, GRID): least level in each step; edges, each axis
        closed by infinity; places (t, 6): first cell, three axes, cells per level of
        the first and second; linear (1 + d, w): offset and slope; cells (c, w), with w
        the joints filled up with zeros to a multiple of 4.
    """
    sizes, joints = [len(axis.edges) + 1 for axis in axes], len(linear[0])
    joined = _joined(tables)
    for triple in find_triples([t for t in joined if len(t) == 2], sizes):
        joined[triple] = _cube(joined, triple)
    missing = (0, 0), (0, -joints % 4)
    places, cells = _places(joined, joints)
    return (
        *_grids(axes, *span),
        places,
        np.pad(np.vstack(linear), missing),
        np.pad(cells, missing),
    )


def find_triples(pairs: Sequence[Pair], sizes: Sequence[int]) -> list[tuple]:
    """Choose triples of axes whose three pairs are all given, no pair used twice.

    Args:
        pairs: Pairs of axes, the smaller number first.
        sizes: Levels of each axis: a triple must not have more than CUBE cells.

    Returns:
        The triples; as many as a search of bounded length finds.
    """
    best: list[tuple] = []
    tries = 0

    def search(left: frozenset, chosen: list[tuple]) -> None:
        nonlocal best, tries
        tries += 1
        if len(chosen) > len(best):
            best = chosen
        if tries > TRIES or len(chosen) + len(left) // 3 <= len(best):
            return
        a, b = min(left)
        for c in range(b + 1, len(sizes)):
            sides = {(a, b), (a, c), (b, c)}
            if sides <= left and prod(sizes[i] for i in (a, b, c)) <= CUBE:
                search(left - sides, [*chosen, (a, b, c)])
        search(left - {(a, b)}, chosen)

    search(frozenset(p for p in pairs if p[0] < p[1]), [])
    return best


def _joined(tables: Sequence[Table]) -> Tables:
    """Tables by their axes; those of the same axes are added."""
    out: Tables = {}
    for table in tables:
        out[table.axes] = (
            out[table.axes] + table.values if table.axes in out else (table.values)
        )
    return out


def _cube(tables: Tables, triple: tuple[int, int, int]) -> Array:
    a, b, c = triple
    cube = tables.pop((a, b))[:, :, None] + tables.pop((a, c))[:, None]
    return cube + tables.pop((b, c))[None]


def _places(tables: Mapping[tuple[int, ...], Array], joints: int) -> tuple:
    places, cells, start = [], [np.zeros((1, joints))], 1
    for axes, values in tables.items():
        # Fewer axes: the first is repeated, with no cells per level.
        a, b, c = (axes[0],) * (3 - len(axes)) + axes
        shape = (1, 1, *values.shape[:-1])
        first = shape[-1] * shape[-2] if len(axes) == 3 else 0
        places.append((start, a, b, c, first, shape[-1] if len(axes) > 1 else 0))
        cells.append(values.reshape(-1, joints))
        start += len(cells[-1])
    return np.array(places, np.uint64).reshape(-1, 6), np.concatenate(cells)


def _grids(axes: Sequence[Axis], low: Array, high: Array) -> tuple[Array, ...]:
    first, starts, grid, edges = [], [], [], []
    for axis in axes:
        lowest = low[axis.variable]
        rate = GRID / max(high[axis.variable] - lowest, 1e-300)
        steps = lowest + np.arange(GRID) / rate
        starts.append(np.searchsorted(axis.edges, steps, side="right"))
        grid.append((lowest, rate))
        first.append((axis.variable, sum(map(len, edges))))
        edges.append(np.append(axis.edges, np.inf))
    return (
        np.array(first, np.int64).reshape(-1, 2),
        np.array(grid, float).reshape(-1, 2),
        np.array(starts, np.int64).reshape(-1, GRID),
        np.concatenate([*edges, [np.inf]]),
    )
