"""Nominal-level PLSR with interactions: the paper's modified PLSR (eq. 30, 14 to 27).

Each variable becomes a column per level, each two columns of different variables their
product: 36 tables for 9 variables, 17 424 columns at 22 levels. No column is formed:
see `residual/tables/kernels.py`. Kernel PLS: Dayal and MacGregor (1997),
algorithm 1.
"""

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from residual.errors import InputError
from residual.recording import Array
from residual.tables.crossval import EXHAUSTED, as_names, as_pair, check_count, frozen
from residual.tables.levels import (
    Cells,
    Levels,
    equal_levels,
    merge_rows,
    quantile_levels,
)
from residual.tables.lookup import Axis, Lookup, Table


@dataclass(frozen=True, slots=True)
class NominalForm:
    """How variables become tables."""

    # Levels of all variables, or of each; the paper's figure 12 chose 22.
    levels: int | tuple[int, ...] = 22
    components: int = 15  # components A; the paper does not say, 15 is a budget
    spacing: str = "equal"  # "equal" (paper) or "quantile"
    velocities: tuple[int, ...] = ()  # columns with velocities, for quantile levels
    scale_y: bool = False  # scale the responses, so that none dominates by its size
    # Share of a component's largest weight under which weights are zero: sparse PLSR
    # (Chun and Keles 2010, section 3); 0 keeps all.
    sparsity: float = 0.0

    def make_levels(self, X: Array, names: tuple[str, ...] | None = None) -> Levels:
        """Return the levels of calibration rows."""
        if self.spacing == "equal":
            return equal_levels(X, self.levels, names)
        if self.spacing == "quantile":
            return quantile_levels(X, self.levels, names, velocities=self.velocities)
        raise InputError(f"spacing must be equal or quantile, got '{self.spacing}'.")


@dataclass(frozen=True, eq=False, slots=True)
class NominalPls:
    """A fitted model; any number of leading components is a model of its own.

    The p columns are the pairs of levels in the order of eq. 30.
    """

    levels: Levels  # levels of the variables
    x_mean: Array  # share of rows in each column, (p,)
    # Mean and scale of the responses, (j,).
    y_mean: Array
    y_scale: Array
    # Weights for X itself, and loadings, by row, (A, p).
    V: Array
    P: Array
    Q: Array  # loadings of the scaled responses, by row, (A, j)
    energy: Array  # squared length of each score, t't, (A,)
    rows: int  # calibration rows

    @property
    def components(self) -> int:
        """Number of components A; fewer than asked for where nothing was left."""
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
        return self.V[:a].T @ (self.Q[:a] * self.y_scale)

    def offset(self, components: int | None = None) -> Array:
        """b0 = ybar - xbar B (eq. 26), in units of Y. Shape (j,)."""
        return self.y_mean - self.x_mean @ self.coefficients(components)

    def predict(self, X: Array, components: int | None = None) -> Array:
        """Return b0 + x B (eq. 24), in units of Y. Shape (m, j)."""
        B = self.coefficients(components)
        return self.read(X, B) + (self.y_mean - self.x_mean @ B)

    def tables(self, components: int | None = None) -> tuple[Array, ...]:
        """B cut into its tables. Each of shape (levels, levels, j), in units of Y."""
        sizes = self.levels.sizes
        shapes = [(sizes[i], sizes[j]) for i, j in self.pairs]
        ends = np.cumsum([a * b for a, b in shapes])[:-1]
        cut = np.split(self.coefficients(components), ends)
        return tuple(t.reshape(*s, -1) for t, s in zip(cut, shapes, strict=True))

    def transform(self, X: Array) -> Array:
        """Scores of rows, t = (x - xbar) V (eq. 21). Shape (m, A)."""
        return self.read(X, self.V.T) - self.V @ self.x_mean

    def unvisited_share(self, X: Array) -> Array:
        """Share of each row's cells that no calibration row visited. Shape (m,)."""
        seen = (self.x_mean > 0).astype(float)[:, None]
        return 1 - self.read(X, seen)[:, 0] / len(self.pairs)

    def read(self, X: Array, table: Array) -> Array:
        """X's columns, which nobody forms, times a table. Shapes (m, d), (p, k)."""
        from residual.tables.kernels import gather_pairs

        codes = self.levels.encode(X)
        values, sizes = codes.values.astype(np.uint16), np.array(codes.sizes, np.int64)
        out = np.empty((len(values), table.shape[1]))
        gather_pairs(values, sizes, np.ascontiguousarray(table), out)
        return out


def fit_nominal_pls(
    X: Array,
    Y: Array,
    form: NominalForm | None = None,
    levels: Levels | None = None,
    fewer: bool = False,
) -> NominalPls:
    """Fit the paper's modified PLSR.

    Args:
        X: Variables, such as q, qd, qdd of joints 1 to 3. Shape (n, d), d at least 2.
        form: Levels and components; the paper's form if None.
        levels: Levels to use in place of those that the form makes of X.
        fewer: Whether to take fewer components where the rows bear no more.

    Raises:
        InputError: On fewer than 2 levels or variables, a constant column, more
            components than the rank can be, or a value that is not finite.
    """
    from residual.tables.kernels import scatter_pairs

    X, Y = as_pair(X, Y)
    form = form or NominalForm()
    levels = form.make_levels(X) if levels is None else levels
    cells = merge_rows(levels.encode(X))
    if fewer:
        count = min(form.components, component_bound(cells))
        form = replace(form, components=count)
    check_components(cells, form.components)
    if not 0 <= form.sparsity < 1:
        raise InputError(
            f"sparsity must be at least 0 and under 1, got {form.sparsity}: it is the "
            "share of the largest weight under which weights become zero."
        )
    scale = response_scale(Y, form.scale_y)
    n, y_mean = len(Y), Y.mean(axis=0)
    table = np.zeros((cells.pair_columns, Y.shape[1] + 1))
    weighted = np.column_stack([cells.sums((Y - y_mean) / scale), cells.count])
    scatter_pairs(cells.codes, cells.sizes, weighted, table)
    x_mean = table[:, -1] / n
    # The responses are centred, so that their product with X - xbar is that with X.
    S = np.ascontiguousarray(table[:, :-1].T)
    parts = _components(cells, S, x_mean, form)
    return NominalPls(levels, *map(frozen, (x_mean, y_mean, scale, *parts)), n)


def component_bound(cells: Cells) -> int:
    """Most components that there can be.

    The centred indicators have no more rank than there are cells less one, and than
    main effects and interactions of the visited levels have dimensions.
    """
    free = np.array([len(np.unique(c)) - 1 for c in cells.codes.T])
    inner = (free.sum() ** 2 - (free**2).sum()) // 2
    return int(min(len(cells.count) - 1, free.sum() + inner))


def check_components(cells: Cells, components: int) -> None:
    """Refuse more components than there can be, and tables of one variable."""
    check_count(len(cells.sizes), 2, 64, "variables", "A table is of two variables.")
    remedy = (
        f"The bound is the rank of the tables ({len(cells.count)} distinct rows, up to "
        f"{int(cells.sizes.max())} levels): take more rows or fewer components."
    )
    check_count(components, 1, component_bound(cells), "components", remedy)


def response_scale(Y: Array, scale_y: bool) -> Array:
    """Scale of each response: its standard deviation if asked for, else 1. (j,)."""
    scale = Y.std(axis=0) if scale_y else np.ones(Y.shape[1])
    return np.where(scale > 0, scale, 1.0)


def leading(S: Array) -> tuple[Array, float]:
    """Eigenvector of S S' to its largest eigenvalue, and S's norm. Shape (j, p)."""
    values, vectors = np.linalg.eigh(S @ S.T)
    q = np.ascontiguousarray(vectors[:, -1])
    return q * np.sign(q[np.abs(q).argmax()]), float(max(values[-1], 0.0) ** 0.5)


def _components(
    cells: Cells, S: Array, x_mean: Array, form: NominalForm
) -> tuple[Array, ...]:
    """Return V, P, Q and t't."""
    from residual.tables.kernels import aim, explain, score, turn

    count = form.components
    W, V, P = (np.zeros((count, S.shape[1])) for _ in range(3))
    Q, energy = np.zeros((count, len(S))), np.zeros(count)
    first, done = 0.0, 0
    for a in range(count):
        q, size = leading(S)
        first = first or size
        if size <= EXHAUSTED * first:
            break
        aim(S, q, W[a], form.sparsity)
        turn(W, V, P, a)
        middle = float(x_mean @ V[a])
        energy[a], total = score(
            cells.codes, cells.sizes, cells.count, V[a], middle, P[a]
        )
        Q[a] = explain(S, V[a], P[a], x_mean, energy[a], total)
        done = a + 1
    return V[:done], P[:done], Q[:done], energy[:done]


def fill_unvisited(model: NominalPls) -> NominalPls:
    """Return the model with weights in cells that no calibration row visited.

    The paper's last section asks for "a pyramidal representation of nominal levels"
    where the state space was not sampled. A table at half as many levels of either
    variable has a cell for four; its value is the mean of those that rows visited.
    Where none of the four was, the level above it is asked, up to the mean of all.

    Predictions of calibration rows stay as they are, and so do offsets: their share of
    such cells is zero.
    """
    sizes, start = model.levels.sizes, 0
    V = model.V.copy()
    for first, second in model.pairs:
        shape = (sizes[first], sizes[second])
        cells = slice(start, start + shape[0] * shape[1])
        start = cells.stop
        V[:, cells] = _filled(V[:, cells], model.x_mean[cells], shape)
    return replace(model, V=frozen(V))


def _filled(weights: Array, share: Array, shape: tuple[int, int]) -> Array:
    """Weights of one table, all cells. Shapes (A, k), (k,)."""
    out, empty = weights.copy(), share <= 0
    rows, columns = np.divmod(np.arange(len(share)), shape[1])
    width = 2
    while empty.any():
        across = -(-shape[1] // width)
        parent = rows // width * across + columns // width
        mass = np.bincount(parent, share)
        known = empty & (mass[parent] > 0)
        for a, own in enumerate(weights):
            sums = np.bincount(parent, own * share)
            out[a, known] = sums[parent[known]] / mass[parent[known]]
        empty &= ~known
        width *= 2
    return out


def nominal_lookup(model: NominalPls, components: int | None = None) -> Lookup:
    """The paper form as its 36 tables per joint, of some leading components, or all."""
    levels, offset = model.levels, model.offset(components)
    pairs = zip(model.pairs, model.tables(components), strict=True)
    return Lookup(
        levels.names,
        as_names(None, len(offset), "joint "),
        tuple(Axis(i, edges) for i, edges in enumerate(levels.edges)),
        tuple(Table(pair, values) for pair, values in pairs),
        offset,
        frozen(np.zeros((len(levels.names), len(offset)))),
        levels.low,
        levels.high,
    )
