"""Main effects: one table per variable, on levels of several widths at once.

Friction is a function of one variable: a table of the velocity holds it on any path,
while pair tables would have to see it beside every value of the others. Wide and narrow
levels are fitted together by ridge regression: where rows are few the wide ones speak,
where they are many the narrow ones do.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

from residual.blocks import as_pair, frozen
from residual.cells import merge_rows
from residual.errors import InputError
from residual.levels import Codes, Levels, quantile_levels
from residual.recording import Array

PYRAMID = (5, 10, 20, 40)  # levels, from wide to narrow
RIDGES = (1.0, 10.0, 100.0, 1000.0)  # per ROWS rows
ROWS = 20_000
KEPT = 1e-10  # share of the largest singular value below which a level is a copy


@dataclass(frozen=True, eq=False, slots=True)
class Pyramid:
    """Levels of several widths over the same variables.

    Attributes:
        levels: The union of all edges; tables are on these.
        roots: One matrix per variable whose product with its transpose counts in how
            many widths two levels fall together. Shapes (k, r).
    """

    levels: Levels
    roots: tuple[Array, ...]


@dataclass(frozen=True, eq=False, slots=True)
class MainEffects:
    """One table per variable and response.

    Attributes:
        levels: Levels of the variables.
        offset: Mean of the responses. Shape (j,).
        tables: Correction by level, of zero mean over the calibration rows. One of
            shape (k, j) per variable, in units of Y.
        ridge: Ridge per 20 000 rows.
    """

    levels: Levels
    offset: Array
    tables: tuple[Array, ...]
    ridge: float

    def predict(self, X: Array) -> Array:
        """Return offset + the sum of all tables, in units of Y. Shape (m, j)."""
        return self.read(self.levels.encode(X))

    def read(self, codes: Codes) -> Array:
        """Return the prediction at levels that are known already. Shape (m, j)."""
        out = np.repeat(self.offset[None], len(codes.values), axis=0)
        for column, table in zip(codes.values.T, self.tables, strict=True):
            out += table[column]
        return out


def make_pyramid(
    X: Array,
    widths: Sequence[int] = PYRAMID,
    names: Sequence[str] | None = None,
    *,
    velocities: Sequence[int] = (),
) -> Pyramid:
    """Return quantile levels of several widths (see `quantile_levels`).

    Raises:
        InputError: As `quantile_levels`, and if there are no widths.
    """
    if not widths:
        raise InputError("The pyramid needs at least one number of levels, got none.")
    layers = [quantile_levels(X, w, names, velocities=velocities) for w in widths]
    edges, roots = [], []
    for i in range(len(layers[0].edges)):
        union = np.unique(np.concatenate([layer.edges[i] for layer in layers]))
        # A level of the union is known by its lower edge.
        starts = np.concatenate([[-np.inf], union])
        groups = [np.searchsorted(y.edges[i], starts, side="right") for y in layers]
        edges.append(frozen(union))
        roots.append(frozen(_root(groups)))
    first = layers[0]
    levels = Levels(first.names, tuple(edges), first.low, first.high)
    return Pyramid(levels, tuple(roots))


def fit_main_effects(
    X: Array, Y: Array, pyramid: Pyramid, ridges: Sequence[float] = RIDGES
) -> tuple[MainEffects, ...]:
    """Fit all tables by ridge regression, for several ridges at once.

    min |Y - ybar - (Z - zbar) beta|^2 + ridge n / 20000 |beta|^2, Z one column per
    level of every width. With D mapping levels of the union to those columns, tables
    are g = D beta; D D' = L L' gives the same g from columns Z L, which are fewer.

    Args:
        X: Variables. Shape (n, d).
        Y: Responses. Shape (n, j).
        pyramid: The levels.
        ridges: Ridges per 20 000 rows, at least 0.

    Returns:
        One fit per ridge.

    Raises:
        InputError: On blocks of different length or a ridge that is not positive.
    """
    X, Y = as_pair(X, Y)
    if not len(ridges) or min(ridges) <= 0:
        raise InputError(
            f"ridges must be above 0, got {list(ridges)}: levels of several widths "
            "overlap and have no other unique solution. 1, 10, 100, 1000 are usual."
        )
    codes = pyramid.levels.encode(X)
    count, sums = _joint_sums(codes, Y)
    n, y_mean = len(Y), Y.mean(axis=0)
    share = np.diag(count) / n
    L = _block_diagonal(pyramid.roots)
    middle = share @ L
    values, U = np.linalg.eigh(L.T @ count @ L - n * np.outer(middle, middle))
    right = U.T @ (L.T @ sums - n * np.outer(middle, y_mean))
    fits = []
    for ridge in ridges:
        solved = right / (np.maximum(values, 0) + ridge * n / ROWS)[:, None]
        tables = _centred(L @ (U @ solved), share, codes.sizes)
        fits.append(MainEffects(pyramid.levels, frozen(y_mean), tables, float(ridge)))
    return tuple(fits)


def _root(groups: Sequence[Array]) -> Array:
    together = sum((g[:, None] == g[None, :]).astype(float) for g in groups)
    values, vectors = np.linalg.eigh(together)
    kept = values > KEPT * values[-1]
    return vectors[:, kept] * np.sqrt(values[kept])


def _joint_sums(codes: Codes, Y: Array) -> tuple[Array, Array]:
    """Z'Z and Z'Y of the indicators of single levels. Shapes (k, k), (k, j)."""
    cells = merge_rows(codes)
    starts = np.concatenate([[0], np.cumsum(cells.sizes)[:-1]])
    size = int(cells.sizes.sum())
    count, sums = np.zeros((size, size)), np.zeros((size, Y.shape[1]))
    _count_pairs(cells.codes, starts, cells.count, cells.sums(Y), count, sums)
    upper = np.triu(count, 1)
    return count + upper.T, sums


@njit(cache=True)
def _count_pairs(codes, starts, weight, totals, count, sums):
    """Fill the upper triangle of Z'Z, and Z'Y, from cells and their sums."""
    for c in range(codes.shape[0]):
        for i in range(codes.shape[1]):
            a = starts[i] + codes[c, i]
            for m in range(totals.shape[1]):
                sums[a, m] += totals[c, m]
            for j in range(i, codes.shape[1]):
                count[a, starts[j] + codes[c, j]] += weight[c]


def _block_diagonal(roots: Sequence[Array]) -> Array:
    rows, columns = (sum(r.shape[axis] for r in roots) for axis in (0, 1))
    out = np.zeros((rows, columns))
    row = column = 0
    for root in roots:
        out[row : row + len(root), column : column + root.shape[1]] = root
        row, column = row + len(root), column + root.shape[1]
    return out


def _centred(stacked: Array, share: Array, sizes: Sequence[int]) -> tuple[Array, ...]:
    """Cut into tables whose mean over the rows is zero; the offset is then ybar."""
    ends = np.cumsum(sizes)[:-1]
    tables = np.split(stacked, ends)
    shares = np.split(share, ends)
    return tuple(frozen(t - s @ t) for t, s in zip(tables, shares, strict=True))
