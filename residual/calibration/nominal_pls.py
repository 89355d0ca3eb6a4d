"""Nominal-level PLSR with interactions: the paper's modified PLSR (eq. 30, 14 to 27).

Each variable becomes a column per level, each two columns of different variables their
product: 36 tables for 9 variables, 17 424 columns at 22 levels. No column is formed:
see `residual/calibration/kernels.py`. Kernel PLS: Dayal and MacGregor (1997),
algorithm 1.
"""

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from residual.calibration.components import EXHAUSTED, leading
from residual.calibration.levels import Levels, equal_levels, merge_rows
from residual.model.lookup import Axis, Lookup, LookupTable
from residual.quantity import as_names, as_pair, check_count, frozen
from residual.recording import Array


@dataclass(frozen=True, slots=True)
class NominalForm:
    """How variables become tables."""

    # Levels of all variables, or of each; the paper's figure 12 chose 22.
    levels: int | tuple[int, ...] = 22
    components: int = 15  # components A; the paper does not say, 15 is a budget


@dataclass(frozen=True, eq=False, slots=True)
class NominalPls:
    """A fitted model; any number of leading components is a model of its own.

    The p columns are the pairs of levels in the order of eq. 30.
    """

    levels: Levels  # levels of the variables
    x_mean: Array  # share of rows in each column, (p,)
    y_mean: Array  # mean of the responses, (j,)
    V: Array  # weights for X itself, by row, (A, p)
    Q: Array  # loadings of the responses, by row, (A, j)

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
        return self.V[:a].T @ self.Q[:a]

    def offset(self, components: int | None = None) -> Array:
        """b0 = ybar - xbar B (eq. 26), in units of Y. Shape (j,)."""
        return self.y_mean - self.x_mean @ self.coefficients(components)

    def predict(self, X: Array, components: int | None = None) -> Array:
        """Return b0 + x B (eq. 24), in units of Y. Shape (m, j)."""
        B = self.coefficients(components)
        return self._read(X, B) + (self.y_mean - self.x_mean @ B)

    def transform(self, X: Array) -> Array:
        """Scores of rows, t = (x - xbar) V (eq. 21). Shape (m, A)."""
        return self._read(X, self.V.T) - self.V @ self.x_mean

    def lookup(self, components: int | None = None) -> Lookup:
        """Return its tables, of some leading components or of all."""
        levels, offset = self.levels, self.offset(components)
        sizes = [[levels.sizes[i] for i in pair] for pair in self.pairs]
        ends = np.cumsum([a * b for a, b in sizes])[:-1]
        parts = np.split(self.coefficients(components), ends)
        cut = zip(self.pairs, parts, sizes, strict=True)
        return Lookup(
            levels.names,
            as_names(None, len(offset), "joint "),
            tuple(Axis(i, edges) for i, edges in enumerate(levels.edges)),
            tuple(LookupTable(pair, B.reshape(*size, -1)) for pair, B, size in cut),
            offset,
            frozen(np.zeros((len(levels.names), len(offset)))),
            levels.low,
            levels.high,
        )

    def _read(self, X: Array, table: Array) -> Array:
        """X's columns, which nobody forms, times a table. Shapes (m, d), (p, k)."""
        from residual.calibration.kernels import gather_pairs

        codes = self.levels.encode(X)
        values, sizes = codes.values.astype(np.uint16), np.array(codes.sizes, np.int64)
        out = np.empty((len(values), table.shape[1]))
        gather_pairs(values, sizes, np.ascontiguousarray(table), out)
        return out


def fit_nominal_pls(
    X: Array, Y: Array, form: NominalForm | None = None, fewer: bool = False
) -> NominalPls:
    """Fit the paper's modified PLSR.

    Args:
        X: Variables, such as q, qd, qdd of joints 1 to 3. Shape (n, d), d at least 2.
        form: Levels and components; the paper's form if None.
        fewer: Whether to take fewer components where the rows bear no more.

    Raises:
        InputError: On fewer than 2 levels or variables, a constant column, more
            components than the rank can be, or a value that is not finite.
    """
    from residual.calibration.kernels import aim, explain, scatter_pairs, score, turn

    X, Y = as_pair(X, Y)
    form = form or NominalForm()
    levels = equal_levels(X, form.levels)
    cells = merge_rows(levels.encode(X))
    # The centred indicators have no more rank than there are cells less one, and than
    # main effects and interactions of the visited levels have dimensions.
    visited = np.array([len(np.unique(c)) - 1 for c in cells.codes.T])
    inner = (visited.sum() ** 2 - (visited**2).sum()) // 2
    bound = int(min(len(cells.count) - 1, visited.sum() + inner))
    if fewer:
        form = replace(form, components=min(form.components, bound))
    check_count(len(cells.sizes), 2, 64, "variables", "A table is of two variables.")
    remedy = (
        f"The bound is the rank of the tables ({len(cells.count)} distinct rows, up to "
        f"{int(cells.sizes.max())} levels): take more rows or fewer components."
    )
    check_count(form.components, 1, bound, "components", remedy)
    n, y_mean = len(Y), Y.mean(axis=0)
    table = np.zeros((cells.pair_columns, Y.shape[1] + 1))
    weighted = np.column_stack([cells.sums(Y - y_mean), cells.count])
    scatter_pairs(cells.codes, cells.sizes, weighted, table)
    x_mean = table[:, -1] / n
    # The responses are centred, so that their product with X - xbar is that with X.
    S = np.ascontiguousarray(table[:, :-1].T)
    W, V, P = (np.zeros((form.components, S.shape[1])) for _ in range(3))
    Q = np.zeros((form.components, len(S)))
    first, done = 0.0, 0
    for a in range(form.components):
        q, size = leading(S)
        first = first or size
        if size <= EXHAUSTED * first:
            break
        aim(S, q, W[a])
        turn(W, V, P, a)
        middle = float(x_mean @ V[a])
        energy, total = score(cells.codes, cells.sizes, cells.count, V[a], middle, P[a])
        Q[a] = explain(S, V[a], P[a], x_mean, energy, total)
        done = a + 1
    return NominalPls(levels, *map(frozen, (x_mean, y_mean, V[:done], Q[:done])))
