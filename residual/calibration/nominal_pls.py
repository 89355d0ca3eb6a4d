"""Levels of variables, and partial least squares regression (PLSR) of states and levels.

Kernel PLS: Dayal and MacGregor (1997), algorithm 1 (paper, eq. 14 to 27). The paper's
modified PLSR (eq. 30) uses levels with interactions: each variable becomes a column per
level, and each pair of columns of different variables a product: 36 tables for 9
variables, 17 424 columns at 22 levels. No column is formed: the number of a level encodes
it in two bytes (section 2.6.1), and compiled loops work on these numbers
(`residual/calibration/kernels.py`). Rows that share all levels are merged.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from residual.errors import InputError
from residual.model.lookup import LevelAxis, Lookup, LookupTable
from residual.quantity import (
    check_block,
    check_block_pair,
    check_column_names,
    check_count,
    check_rows,
    check_varying,
    make_read_only,
)
from residual.recording import Array

# Covariance below this share of the first one is rounding: nothing is left to explain.
EXHAUSTED = 1e-12
MOST = 4096  # levels of one variable; more than an encoder resolves in a log
DWELL = 1e-3  # rad/s: a joint slower than this stands still


@dataclass(frozen=True, eq=False, slots=True)
class PlsModel:
    """A fitted regression; any number of leading components is a separate model."""

    # Mean and standard deviation of X (paper, eq. 18), (k,).
    x_mean: Array
    x_scale: Array
    y_mean: Array  # mean of Y, (j,)
    V: Array  # weights that give scores from scaled X itself (eq. 19), (k, A)
    Q: Array  # loadings of Y (eq. 16), (j, A)

    def linear(self, components: int) -> tuple[Array, Array]:
        """Constant (j,) and slope (k, j) of some leading components (eq. 25, 26)."""
        a = components
        slope = self.V[:, :a] @ self.Q[:, :a].T / self.x_scale[:, None]
        return self.y_mean - self.x_mean @ slope, slope


def fit_pls(X: Array, Y: Array) -> PlsModel:
    """Fit a partial least squares regression (paper, eq. 14 to 27).

    Kernel PLS (Dayal and MacGregor 1997, algorithm 1), from Z'Z and Z'Y alone. Columns
    of X are scaled to unit variance: rad, rad/s and rad/s^2 do not compare. There are as
    many components as the rank of X; fewer where nothing of Y is left to explain.

    Args:
        X: Regressors. Shape (n, k).
        Y: Responses. Shape (n, j).

    Raises:
        InputError: On a constant column, blocks of different length, or a value that is
            not finite.
    """
    X, Y = check_block_pair(X, Y)
    check_count(len(X), 2, 2**62, "rows of X", "Take a longer log.")
    check_varying(X, check_column_names(None, X.shape[1], "x"))
    x_mean, x_scale, y_mean = X.mean(axis=0), X.std(axis=0, ddof=1), Y.mean(axis=0)
    Z = (X - x_mean) / x_scale
    parts = _components(Z.T @ Z, Z.T @ (Y - y_mean), int(np.linalg.matrix_rank(Z)))
    return PlsModel(*map(make_read_only, (x_mean, x_scale, y_mean, *parts)))


def find_leading_direction(S: Array) -> tuple[Array, float]:
    """Eigenvector of S S' to its largest eigenvalue, and S's norm. Shape (j, p)."""
    values, vectors = np.linalg.eigh(S @ S.T)
    q = np.ascontiguousarray(vectors[:, -1])
    return q * np.sign(q[np.abs(q).argmax()]), float(max(values[-1], 0.0) ** 0.5)


def _components(G: Array, S: Array, count: int) -> tuple[Array, Array]:
    """Return V and Q from G = Z'Z (k, k) and S = Z'Y (k, j)."""
    V, P, Q = (np.zeros((count, n)) for n in (len(G), len(G), S.shape[1]))
    first, done = 0.0, 0
    for a in range(count):
        q, size = find_leading_direction(S.T)
        first = first or size
        if size <= EXHAUSTED * first:
            break
        w = S @ q / size
        # Twice: rounding of long products would make late scores oblique.
        v = w - V[:a].T @ (P[:a] @ w)
        V[a] = v - V[:a].T @ (P[:a] @ v)
        energy = V[a] @ G @ V[a]
        P[a], Q[a] = G @ V[a] / energy, V[a] @ S / energy
        S = S - energy * np.outer(P[a], Q[a])
        done = a + 1
    return V[:done].T.copy(), Q[:done].T.copy()


@dataclass(frozen=True, eq=False, slots=True)
class VariableLevels:
    """Intervals of each variable, with their calibrated range."""

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

    def encode(self, X: Array) -> Array:
        """Return the level of every value, from 0; the outermost reach to infinity.

        Shape (n, d), uint16.
        """
        X = check_rows(X, self.names, "the levels are of")
        codes = np.empty(X.shape, np.uint16)
        for i, edges in enumerate(self.edges):
            codes[:, i] = np.searchsorted(edges, X[:, i], side="right")
        return make_read_only(codes)


Count = int | Sequence[int]  # levels of all variables, or of each


def build_levels(
    X: Array,
    count: Count,
    names: Sequence[str] | None = None,
    *,
    equally_wide: bool = False,
    velocities: Collection[int] = (),
    allow_constant: bool = False,
) -> VariableLevels:
    """Levels that hold about equally many calibration rows each, or are equally wide.

    Equal edges, which many equal values make, are merged, so a variable may get fewer
    levels. Velocities of both signs get a level for standstill and half of the levels on
    either side: friction jumps there, and a level that straddles zero cannot separate
    the sides.

    Args:
        count: Levels of all variables, or of each, at least 2.
        equally_wide: Whether all levels of a variable are (paper, section 2.6.1).
        velocities: Columns (from 0) that hold velocities [rad/s].
        allow_constant: Whether a column may be constant; it then has one level.
    """
    X = check_block(X, "X")
    names = check_column_names(names, X.shape[1], "x")
    counts = list(count) if isinstance(count, Sequence) else [count] * len(names)
    if len(counts) != len(names):
        raise InputError(
            f"levels are of {len(counts)} variables, the rows of {len(names)}: give "
            "one number for all, or one for each."
        )
    for levels in counts:
        check_count(levels, 2, MOST, "levels", "One level cannot tell two states apart.")
    if not allow_constant:
        check_varying(X, names)
    low, high = make_read_only(X.min(axis=0)), make_read_only(X.max(axis=0))
    edges = []
    for i, (column, k) in enumerate(zip(X.T, counts, strict=True)):
        if equally_wide:
            edges.append(low[i] + (high[i] - low[i]) * np.arange(1, k) / k)
        else:
            place = _around_zero if i in velocities else _quantiles
            edges.append(place(column, k))
    return VariableLevels(names, tuple(map(make_read_only, edges)), low, high)


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
class LevelCells:
    """Distinct combinations of levels."""

    codes: Array  # levels of each cell, in ascending order of rows; uint16, (c, d)
    sizes: Array  # number of levels of each variable, (d,)
    count: Array  # rows in each cell, (c,)
    of_row: Array  # cell of each row, (n,)

    def sums(self, Y: Array) -> Array:
        """Sum of each column over the rows of each cell. Shape (c, j)."""
        columns = [np.bincount(self.of_row, y, len(self.count)) for y in Y.T]
        return np.stack(columns, axis=1)


def merge_equal_rows(codes: Array, sizes: Sequence[int]) -> LevelCells:
    """Merge rows with equal levels (n, d); return them with their numbers.

    Neighbours share their first variables, so that successive tables are close in
    memory.
    """
    wide = np.ascontiguousarray(codes.astype(">u2"))  # whose bytes are in that order
    key = wide.view(np.dtype((np.void, 2 * wide.shape[1]))).ravel()
    _, first, of_row, count = np.unique(
        key, return_index=True, return_inverse=True, return_counts=True
    )
    return LevelCells(
        make_read_only(np.ascontiguousarray(codes[first])),
        make_read_only(np.array(sizes, dtype=np.int64)),
        make_read_only(count.astype(float)),
        make_read_only(of_row.reshape(-1)),
    )


@dataclass(frozen=True, slots=True)
class NominalPlsForm:
    """How variables become tables."""

    # Levels of all variables, or of each; the paper's figure 12 chose 22.
    levels: int | tuple[int, ...] = 22
    components: int = 15  # components A; the paper gives none, 15 is a budget


@dataclass(frozen=True, eq=False, slots=True)
class NominalPls:
    """A fitted model; any number of leading components is a separate model.

    The p columns are the pairs of levels in the order of eq. 30.
    """

    levels: VariableLevels  # levels of the variables
    x_mean: Array  # share of rows in each column, (p,)
    y_mean: Array  # mean of the responses, (j,)
    V: Array  # weights for X itself, by row, (A, p)
    Q: Array  # loadings of the responses, by row, (A, j)

    @property
    def components(self) -> int:
        """Number of components A; fewer than requested if nothing is left to explain."""
        return len(self.V)

    @property
    def pairs(self) -> tuple[tuple[int, int], ...]:
        """The variables of each table, in the order of the columns."""
        return tuple(combinations(range(len(self.levels.names)), 2))

    def coefficients(self, components: int | None = None) -> Array:
        """B = V Q' (eq. 25), in units of Y. Shape (p, j)."""
        a = self.components if components is None else components
        remedy = "Ask for fewer, or fit again with more."
        check_count(a, 0, self.components, "components", remedy)
        return self.V[:a].T @ self.Q[:a]

    def predict(self, X: Array, components: int | None = None) -> Array:
        """Return b0 + x B (eq. 24), in units of Y. Shape (m, j)."""
        B = self.coefficients(components)
        return self._read(X, B) + (self.y_mean - self.x_mean @ B)

    def transform(self, X: Array) -> Array:
        """Scores of rows, t = (x - xbar) V (eq. 21). Shape (m, A)."""
        return self._read(X, self.V.T) - self.V @ self.x_mean

    def lookup(self, components: int | None = None) -> Lookup:
        """Return its tables, of some leading components or of all; eq. 26 for b0."""
        levels, B = self.levels, self.coefficients(components)
        offset = self.y_mean - self.x_mean @ B
        sizes = [[levels.sizes[i] for i in pair] for pair in self.pairs]
        ends = np.cumsum([a * b for a, b in sizes])[:-1]
        parts = np.split(B, ends)
        cut = zip(self.pairs, parts, sizes, strict=True)
        return Lookup(
            levels.names,
            check_column_names(None, len(offset), "joint "),
            tuple(LevelAxis(i, edges) for i, edges in enumerate(levels.edges)),
            tuple(LookupTable(pair, part.reshape(*size, -1)) for pair, part, size in cut),
            offset,
            make_read_only(np.zeros((len(levels.names), len(offset)))),
            levels.low,
            levels.high,
        )

    def _read(self, X: Array, table: Array) -> Array:
        """Return the implicit columns of X times a table. Shapes (m, d), (p, k)."""
        from residual.calibration.kernels import gather_pairs

        codes, sizes = self.levels.encode(X), np.array(self.levels.sizes, np.int64)
        out = np.empty((len(codes), table.shape[1]))
        gather_pairs(codes, sizes, np.ascontiguousarray(table), out)
        return out


def fit_nominal_pls(X: Array, Y: Array, form: NominalPlsForm | None = None) -> NominalPls:
    """Fit the paper's modified PLSR, with fewer components if the rows support fewer.

    Args:
        X: Variables, such as q, qd, qdd of joints 1 to 3. Shape (n, d), d at least 2.
        form: Levels and components; the paper's form if None.

    Raises:
        InputError: On fewer than 2 levels or variables, a constant column, no component,
            or a value that is not finite.
    """
    from residual.calibration.kernels import (
        accumulate_component_scores,
        compute_weight_vector,
        deflate_by_component,
        orthogonalize_weight_vector,
        scatter_pairs,
    )

    X, Y = check_block_pair(X, Y)
    form = form or NominalPlsForm()
    levels = build_levels(X, form.levels, equally_wide=True)
    cells = merge_equal_rows(levels.encode(X), levels.sizes)
    # The rank of the centred indicators is at most the number of cells less one, and the
    # main effects and interactions of the visited levels have dimensions.
    visited = np.array([len(np.unique(c)) - 1 for c in cells.codes.T])
    inner = (visited.sum() ** 2 - (visited**2).sum()) // 2
    bound = int(min(len(cells.count) - 1, visited.sum() + inner))
    components = min(form.components, bound)
    check_count(len(cells.sizes), 2, 64, "variables", "A table is of two variables.")
    remedy = (
        f"The bound is the rank of the tables ({len(cells.count)} distinct rows, up to "
        f"{int(cells.sizes.max())} levels): take more rows or fewer components."
    )
    check_count(components, 1, bound, "components", remedy)
    n, y_mean = len(Y), Y.mean(axis=0)
    # A row for each column that the products of two variables' indicators would take.
    columns = int(cells.sizes.sum() ** 2 - (cells.sizes**2).sum()) // 2
    table = np.zeros((columns, Y.shape[1] + 1))
    weighted = np.column_stack([cells.sums(Y - y_mean), cells.count])
    scatter_pairs(cells.codes, cells.sizes, weighted, table)
    x_mean = table[:, -1] / n
    # The responses are centred, so that their product with X - xbar is that with X.
    S = np.ascontiguousarray(table[:, :-1].T)
    W, V, P = (np.zeros((components, S.shape[1])) for _ in range(3))
    Q = np.zeros((components, len(S)))
    first, done = 0.0, 0
    for a in range(components):
        q, size = find_leading_direction(S)
        first = first or size
        if size <= EXHAUSTED * first:
            break
        compute_weight_vector(S, q, W[a])
        orthogonalize_weight_vector(W, V, P, a)
        middle = float(x_mean @ V[a])
        energy, total = accumulate_component_scores(
            cells.codes, cells.sizes, cells.count, V[a], middle, P[a]
        )
        Q[a] = deflate_by_component(S, V[a], P[a], x_mean, energy, total)
        done = a + 1
    return NominalPls(levels, *map(make_read_only, (x_mean, y_mean, V[:done], Q[:done])))
