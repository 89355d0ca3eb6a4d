"""Main effects: one table per variable, on levels of several widths at once.

Friction is a function of one variable: a table of the velocity holds it on any path,
while pair tables would have to see it beside every value of the others. Wide and narrow
levels are fitted together by ridge regression: where rows are few the wide ones speak,
where they are many the narrow ones do.

A few named pair tables go on what main effects leave, one at a time: load-dependent
friction needs a table of two variables; 36 of them at once mostly learn the path. A
table is added only if it predicts each run from the others.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.linalg import block_diag

from residual.errors import InputError
from residual.recording import Array
from residual.tables.crossval import as_pair, frozen
from residual.tables.levels import Codes, Levels, merge_rows, quantile_levels
from residual.tables.lookup import Table

PYRAMID = (5, 10, 20, 40)  # levels, from wide to narrow
RIDGES = (1.0, 10.0, 100.0, 1000.0)  # per ROWS rows
ROWS = 20_000
KEPT = 1e-10  # share of the largest singular value below which a level is a copy
LEVELS = 12
RIDGE = 50.0  # per ROWS rows: a cell of so few is believed by half
GAIN = 0.03  # least share of the squared rest that a table must explain on unseen runs
MOST = 3


@dataclass(frozen=True, eq=False, slots=True)
class Pyramid:
    """Levels of several widths over the same variables."""

    levels: Levels  # the union of all edges; tables are on these
    # One matrix per variable whose product with its transpose counts in how many widths
    # two levels fall together, (k, r).
    roots: tuple[Array, ...]


@dataclass(frozen=True, eq=False, slots=True)
class MainEffects:
    """One table per variable and response."""

    levels: Levels  # levels of the variables
    offset: Array  # mean of the responses, (j,)
    # Correction by level, of zero mean over the calibration rows. One of shape (k, j)
    # per variable, in units of Y.
    tables: tuple[Array, ...]
    ridge: float  # ridge per 20 000 rows

    def predict(self, X: Array) -> Array:
        """Return offset + the sum of all tables, in units of Y. Shape (m, j)."""
        return self.read(self.levels.encode(X))

    def read(self, codes: Codes) -> Array:
        """Return the prediction at levels that are known already. Shape (m, j)."""
        out = np.repeat(self.offset[None], len(codes.values), axis=0)
        for column, table in zip(codes.values.T, self.tables, strict=True):
            out += table[column]
        return out


@dataclass(frozen=True, eq=False, slots=True)
class Normal:
    """Centred normal equations of the main effects, in their principal directions."""

    codes: Codes  # levels of the rows
    share: Array  # share of the rows in each level, variable after variable, (k,)
    values: Array  # eigenvalues, at least 0, (r,)
    back: Array  # from directions to levels, (k, r)
    right: Array  # right sides, (r, j)
    y_mean: Array  # mean of the responses, (j,)

    def scaled(self, ridge: float) -> float:
        """A ridge per 20 000 rows as it is for so many rows."""
        return ridge * len(self.codes.values) / ROWS

    def effects(self, levels: Levels, solved: Array, ridge: float) -> MainEffects:
        """Tables from coefficients of the directions. Shape of `solved` (r, j)."""
        # Tables of zero mean over the rows: the offset is then that of the responses.
        ends = np.cumsum(self.codes.sizes)[:-1]
        parts = np.split(self.back @ solved, ends), np.split(self.share, ends)
        tables = tuple(frozen(t - s @ t) for t, s in zip(*parts, strict=True))
        return MainEffects(levels, frozen(self.y_mean), tables, float(ridge))

    def cross(self, cell: Array, share: Array) -> Array:
        """Products of the directions with indicators of cells, centred. (r, size).

        Given the cell of each row, and the share of the rows in each cell.
        """
        size = len(share)
        counts = [
            np.bincount(column.astype(np.int64) * size + cell, minlength=k * size)
            for column, k in zip(self.codes.values.T, self.codes.sizes, strict=True)
        ]
        stacked = np.concatenate([c.reshape(-1, size) for c in counts])
        centred = stacked - len(cell) * np.outer(self.share, share)
        return self.back.T @ centred


def make_pyramid(
    X: Array,
    widths: Sequence[int] = PYRAMID,
    names: Sequence[str] | None = None,
    *,
    velocities: Sequence[int] = (),
) -> Pyramid:
    """Return quantile levels of several widths (see `quantile_levels`)."""
    if not widths:
        raise InputError("The pyramid needs at least one number of levels, got none.")
    layers = [quantile_levels(X, w, names, velocities=velocities) for w in widths]
    edges, groups = zip(*unite(layers), strict=True)
    roots = [frozen(root_of(own)) for own in groups]
    return Pyramid(replace(layers[0], edges=edges), tuple(roots))


def unite(layers: Sequence[Levels]) -> list[tuple[Array, list[Array]]]:
    """Return the union of all edges of each variable, and what is one level where.

    By variable: edges (k - 1,), and for each width the level (k,) that each level of
    the union is in.
    """
    out = []
    for own in zip(*(layer.edges for layer in layers), strict=True):
        union = np.unique(np.concatenate(own))
        # A level of the union is known by its lower edge.
        starts = np.concatenate([[-np.inf], union])
        groups = [np.searchsorted(edges, starts, side="right") for edges in own]
        out.append((frozen(union), groups))
    return out


def root_of(groups: Sequence[Array]) -> Array:
    """Return R with R R' the number of widths in which two levels are one. (k, r)."""
    together = sum((g[:, None] == g[None, :]).astype(float) for g in groups)
    values, vectors = np.linalg.eigh(together)
    kept = values > KEPT * values[-1]
    return vectors[:, kept] * np.sqrt(values[kept])


def main_effects(
    normal: Normal, pyramid: Pyramid, ridges: Sequence[float] = RIDGES
) -> tuple[MainEffects, ...]:
    """Fit all tables by ridge regression, once per ridge (per 20 000 rows, above 0)."""
    if not len(ridges) or min(ridges) <= 0:
        raise InputError(
            f"ridges must be above 0, got {list(ridges)}: levels of several widths "
            "overlap and have no other unique solution. 1, 10, 100, 1000 are usual."
        )
    fits = []
    for ridge in ridges:
        solved = normal.right / (normal.values + normal.scaled(ridge))[:, None]
        fits.append(normal.effects(pyramid.levels, solved, ridge))
    return tuple(fits)


def normal_equations(X: Array, Y: Array, pyramid: Pyramid) -> Normal:
    """Return the equations of the main effects, ready for any ridge.

    min |Y - ybar - (Z - zbar) beta|^2 + ridge n / 20000 |beta|^2, Z one column per
    level of every width. With D mapping levels of the union to those columns, tables
    are g = D beta; D D' = L L' gives the same g from columns Z L, which are fewer.
    """
    X, Y = as_pair(X, Y)
    codes = pyramid.levels.encode(X)
    count, sums = _joint_sums(codes, Y)
    n, y_mean = len(Y), Y.mean(axis=0)
    share = np.diag(count) / n
    L = block_diag(*pyramid.roots)
    middle = share @ L
    values, U = np.linalg.eigh(L.T @ count @ L - n * np.outer(middle, middle))
    right = U.T @ (L.T @ sums - n * np.outer(middle, y_mean))
    back = L @ U
    return Normal(codes, share, np.maximum(values, 0), back, right, y_mean)


def _joint_sums(codes: Codes, Y: Array) -> tuple[Array, Array]:
    """Z'Z and Z'Y of the indicators of single levels. Shapes (k, k), (k, j)."""
    cells = merge_rows(codes)
    ends = np.cumsum(cells.sizes)
    size, own = int(ends[-1]), cells.sums(Y)
    count, sums = np.zeros((size, size)), np.zeros((size, Y.shape[1]))
    tables = [slice(end - k, end) for end, k in zip(ends, cells.sizes, strict=True)]
    for i, rows in enumerate(tables):
        codes, k = cells.codes[:, i], cells.sizes[i]
        sums[rows] = np.stack([np.bincount(codes, y, k) for y in own.T], axis=1)
        for j in range(i, len(tables)):
            pair = codes * cells.sizes[j] + cells.codes[:, j]
            block = np.bincount(pair, cells.count, k * cells.sizes[j])
            count[rows, tables[j]] = block.reshape(k, -1)
    upper = np.triu(count, 1)
    return count + upper.T, sums


def add_pairs(
    codes: Codes, rest: Array, run: Array, most: int = MOST
) -> tuple[Table, ...]:
    """Add tables of one response greedily, each the best on runs left out.

    Their axes are those of the codes, shape (k1, k2).

    A cell's correction is its sum over its count plus a ridge. The gain of a table is
    the drop of the squared rest of each run under a table of the other runs. None that
    gains less than 3 % comes back.
    """
    _, run = np.unique(run, return_inverse=True)
    pairs = list(combinations(range(len(codes.sizes)), 2))
    # Rows do not change, so neither do the cells and counts of a pair.
    columns = codes.values.T.astype(np.int64)
    places = [columns[a] * codes.sizes[b] + columns[b] for a, b in pairs]
    sizes = [codes.sizes[a] * codes.sizes[b] for a, b in pairs]
    counts = [_by_run(p, run, size) for p, size in zip(places, sizes, strict=True)]
    found: list[Table] = []
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
        rest -= table[places[best]]
        found.append(Table(pairs[best], frozen(table.reshape(shape))))
    return tuple(found)


def read_pairs(pairs: Sequence[Table], codes: Codes) -> Array:
    """Correction of the first 0, 1, 2 ... tables. Shape (len(pairs) + 1, m)."""
    out = np.zeros((len(pairs) + 1, len(codes.values)))
    for i, pair in enumerate(pairs):
        a, b = (codes.values[:, axis] for axis in pair.axes)
        out[i + 1] = out[i] + pair.values[a, b]
    return out


def _by_run(place: Array, run: Array, size: int, values: Array | None = None) -> Array:
    """Count, or sum, per run and cell. Shape (runs, size)."""
    runs = int(run.max()) + 1
    return np.bincount(run * size + place, values, runs * size).reshape(runs, size)


def _gain(sums: Array, counts: Array, ridge: float) -> float:
    """Drop of the squared rest when each run is corrected by the others."""
    table = (sums.sum(axis=0) - sums) / (counts.sum(axis=0) - counts + ridge)
    return float((2 * table * sums - counts * table**2).sum())
