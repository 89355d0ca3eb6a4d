"""A few named pair tables on what main effects leave, added one at a time.

Load-dependent friction needs a table of two variables; 36 of them at once mostly learn
the path. A table is added only if it predicts each run from the others.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from residual.recording import Array
from residual.tables.blocks import frozen
from residual.tables.levels import Codes, Levels, quantile_levels
from residual.tables.main_tables import ROWS

LEVELS = 12
RIDGE = 50.0  # per ROWS rows: a cell of so few is believed by half
GAIN = 0.03  # least share of the squared rest that a table must explain on unseen runs
MOST = 3


@dataclass(frozen=True, eq=False, slots=True)
class NamedPair:
    """One table of two variables, for one response.

    Attributes:
        variables: Its two variables, from 0.
        table: Correction by level of both, in units of Y. Shape (k1, k2).
        gain: Share of the squared rest that it explained on runs left out.
    """

    variables: tuple[int, int]
    table: Array
    gain: float


def pair_levels(
    X: Array, names: Sequence[str] | None = None, velocities: Collection[int] = ()
) -> Levels:
    """Levels of the named pair tables."""
    return quantile_levels(X, LEVELS, names, velocities=velocities)


def add_pairs(
    codes: Codes, rest: Array, run: Array, most: int = MOST
) -> tuple[NamedPair, ...]:
    """Add tables greedily, each the best on runs left out.

    A cell's correction is its sum over its count plus a ridge. The gain of a table is
    the drop of the squared rest of each run under a table of the other runs.

    Args:
        rest: One response after main effects [N m]. Shape (n,).
        run: Run of each row. Shape (n,).
        most: Tables at most.

    Returns:
        The tables in the order they were found; none if none gains 3 %.
    """
    _, run = np.unique(run, return_inverse=True)
    pairs = list(combinations(range(len(codes.sizes)), 2))
    # Rows do not change, so neither do the cells and counts of a pair.
    places = [_place(codes, pair) for pair in pairs]
    sizes = [codes.sizes[a] * codes.sizes[b] for a, b in pairs]
    counts = [_by_run(p, run, size) for p, size in zip(places, sizes, strict=True)]
    found: list[NamedPair] = []
    rest, power = rest.copy(), float(rest @ rest)
    ridge = RIDGE * len(rest) / ROWS
    while len(found) < most and power > 0:
        cells = zip(places, sizes, strict=True)
        sums = [_by_run(p, run, size, rest) for p, size in cells]
        gains = [_gain(s, c, ridge) for s, c in zip(sums, counts, strict=True)]
        best = int(np.argmax(gains))
        if gains[best] <= GAIN * float(rest @ rest):
            break
        table = sums[best].sum(axis=0) / (counts[best].sum(axis=0) + ridge)
        shape = [codes.sizes[i] for i in pairs[best]]
        share = gains[best] / float(rest @ rest)
        rest -= table[places[best]]
        found.append(NamedPair(pairs[best], frozen(table.reshape(shape)), share))
    return tuple(found)


def read_pairs(pairs: Sequence[NamedPair], codes: Codes) -> Array:
    """Correction of the first 0, 1, 2 ... tables. Shape (len(pairs) + 1, m)."""
    out = np.zeros((len(pairs) + 1, len(codes.values)))
    for i, pair in enumerate(pairs):
        a, b = (codes.values[:, v] for v in pair.variables)
        out[i + 1] = out[i] + pair.table[a, b]
    return out


def _place(codes: Codes, pair: tuple[int, int]) -> Array:
    first, second = (codes.values[:, v].astype(np.int64) for v in pair)
    return first * codes.sizes[pair[1]] + second


def _by_run(place: Array, run: Array, size: int, values: Array | None = None) -> Array:
    """Count, or sum, per run and cell. Shape (runs, size)."""
    runs = int(run.max()) + 1
    return np.bincount(run * size + place, values, runs * size).reshape(runs, size)


def _gain(sums: Array, counts: Array, ridge: float) -> float:
    """Drop of the squared rest when each run is corrected by the others."""
    table = (sums.sum(axis=0) - sums) / (counts.sum(axis=0) - counts + ridge)
    return float((2 * table * sums - counts * table**2).sum())
