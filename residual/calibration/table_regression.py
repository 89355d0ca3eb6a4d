"""Levels of variables, and our form: tables on them, fitted by one ridge regression.

Section 2.6.1 of the paper makes a column of zeros and ones of each level; the number of
the level says the same in two bytes.

Our form is a table for each variable, and one of speed and load for each joint.
Friction is a function of one variable: a table of the velocity holds it on any path,
while the paper's pair tables would have to see it beside every value of the others. The
one pair of variables that has a name is speed and load: friction of a gear grows with
the torque that it carries, and that torque is known, since it is the model's. Its table
is fitted together with the others: fitted after them it would find that they have
already learnt the load as a function of the path.

All tables are fitted by one ridge regression on levels of several widths at once:

    min |Y - ybar - (Z - zbar) g|^2 + ridge n / 20000 g' K^-1 g

with Z a column per level and K the number of widths in which two levels are one. Where
rows are few the wide levels speak, where they are many the narrow ones do.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import block_diag, cho_factor, cho_solve, cholesky, solve_triangular
from scipy.sparse import csr_matrix

from residual.errors import InputError
from residual.model.lookup import LevelAxis, LookupTable
from residual.quantity import (
    check_block,
    check_column_names,
    check_count,
    check_rows,
    check_varying,
    make_read_only,
)
from residual.recording import Array

MOST = 4096  # levels of one variable; no encoder of ours resolves more in a log
DWELL = 1e-3  # rad/s: a joint slower than this stands still


LEVELS, WIDTHS = 20, (1, 2, 4)  # of a variable; levels that are one in each width
PAIR_LEVELS, PAIR_WIDTHS = 12, (1, 2)  # of speed and of load
RIDGES = (20.0, 200.0, 2000.0)  # per ROWS rows
ROWS = 20_000


@dataclass(frozen=True, eq=False, slots=True)
class VariableLevels:
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
    levels. Velocities that go both ways get a level of standing still and half of the
    levels on either side: friction jumps there, and a level that straddles zero cannot
    tell one side from the other.

    Args:
        count: Levels of all variables, or of each, at least 2.
        equally_wide: Whether all levels of a variable are (paper, section 2.6.1).
        velocities: Columns (from 0) that hold velocities [rad/s].
        allow_constant: Whether a column may be constant; all of it is then in one
            level.
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
class TableColumns:
    """The tables that are fitted: levels of the variables, and of speeds and loads.

    Columns of Z are the levels of the variables, then the cells of each joint's table.
    """

    states: VariableLevels
    load_levels: VariableLevels  # speed and load of each joint by turns
    speed_columns: tuple[int, ...]  # column of each joint's speed
    state_penalty: Array  # penalty on the levels of the variables, (k, k)
    paired: tuple[Array, ...]  # ... and on the cells of each joint's table

    @property
    def starts(self) -> Array:
        """First column of each variable, of each joint's table, and their number."""
        sizes = self.load_levels.sizes
        cells = [a * b for a, b in zip(sizes[::2], sizes[1::2], strict=True)]
        return np.cumsum([0, *self.states.sizes, *cells])

    def encode(self, X: Array, loads: Array) -> csr_matrix:
        """Return Z of rows: states (n, d), and loads of the joints [N m] (n, j)."""
        codes = self.load_levels.encode(_by_turns(X[:, self.speed_columns], loads))
        across = np.array(self.load_levels.sizes[1::2])
        cells = codes[:, ::2].astype(np.int64) * across + codes[:, 1::2]
        at = np.hstack([self.states.encode(X), cells]) + self.starts[:-1]
        ends = np.arange(0, at.size + 1, at.shape[1])
        shape = (len(X), int(self.starts[-1]))
        return csr_matrix((np.ones(at.size), at.ravel(), ends), shape=shape)


def choose_table_levels(
    X: Array,
    loads: Array,
    speeds: Sequence[int],
    names: Sequence[str],
    velocities: Sequence[int] | None = None,
) -> TableColumns:
    """Choose levels by rows of states and loads; they say nothing of the responses.

    Args:
        X: States. Shape (n, d).
        loads: Torque that each joint carries by the model [N m]. Shape (n, j).
        speeds: Column of each joint's speed.
        names: Of the states, then of the loads.
        velocities: Columns that hold velocities; those of the joints if None.

    Raises:
        InputError: On a constant column, or a value that is not finite.
    """
    both, turns = _by_turns(X[:, speeds], loads), range(0, 2 * len(speeds), 2)
    moving = speeds if velocities is None else velocities
    states = build_levels(X, LEVELS, names[: X.shape[1]], velocities=moving)
    name_pairs = zip((names[i] for i in speeds), names[X.shape[1] :], strict=True)
    named = [name for pair in name_pairs for name in pair]
    pairs = build_levels(both, PAIR_LEVELS, named, velocities=turns, allow_constant=True)
    single = [sum(_shared(e, width) for width in WIDTHS) for e in states.edges]
    paired = []
    for a, b in zip(pairs.edges[::2], pairs.edges[1::2], strict=True):
        paired.append(sum(np.kron(_shared(a, w), _shared(b, w)) for w in PAIR_WIDTHS))
    penalty = block_diag(*map(np.linalg.inv, single))
    return TableColumns(states, pairs, tuple(speeds), penalty, tuple(map(np.linalg.inv, paired)))


def _by_turns(speeds: Array, loads: Array) -> Array:
    return np.stack([speeds, loads], axis=2).reshape(len(loads), -1)


def _shared(edges: Array, width: int) -> Array:
    """Whether two levels are one where so many neighbours are. Shape (k, k)."""
    level, still = np.arange(len(edges) + 1), np.flatnonzero(edges == -DWELL)
    group = level // width
    if len(still):  # either direction, and standing still, stay apart
        level = level - (still[0] + 1)
        group = np.sign(level) * np.ceil(np.abs(level) / width)
    return (group[:, None] == group[None, :]).astype(float)


@dataclass(eq=False)
class TableRegression:
    """Normal equations of some rows; coefficients are solved for when asked for."""

    tables: TableColumns
    gram: Array  # centred Z'Z, (k, k)
    share: Array  # share of the rows in each column, (k,)
    right: Array  # Z'(Y - ybar), (k, j)
    y_mean: Array  # mean of the responses, (j,)
    rows: int
    _solved: dict[float, tuple[Array, Array]] = field(default_factory=dict)

    def coefficients(self, ridge: float, paired: bool) -> Array:
        """Contribution of each column of Z to each response [N m]. Shape (k, j).

        Those of each table have mean zero over the rows.

        Args:
            ridge: Per 20 000 rows.
            paired: Whether each joint has a table of its speed and load.
        """
        if ridge not in self._solved:
            self._solved[ridge] = self._solve(ridge * self.rows / ROWS)
        return self._solved[ridge][int(paired)]

    def _solve(self, stiff: float) -> tuple[Array, Array]:
        """Coefficients without the tables of speed and load, and with them.

        With A = L L' the system of the variables alone and B that part of a joint's
        cells, the cells solve a Schur complement of their own size.
        """
        count, starts = len(self.tables.state_penalty), self.tables.starts
        A = self.gram[:count, :count] + stiff * self.tables.state_penalty
        L = cholesky(A, lower=True, check_finite=False)

        def forward(b: Array) -> Array:
            return solve_triangular(L, b, lower=True, check_finite=False)

        def back(b: Array) -> Array:
            return solve_triangular(L, b, lower=True, trans="T", check_finite=False)

        right, across = forward(self.right[:count]), forward(self.gram[:count, count:])
        plain, paired = np.zeros((2, *self.right.shape))
        plain[:count] = back(right)
        first = len(self.tables.states.sizes)
        for j, penalty in enumerate(self.tables.paired):
            cells = slice(*starts[first + j : first + j + 2])
            B = across[:, cells.start - count : cells.stop - count]
            schur = self.gram[cells, cells] + stiff * penalty - B.T @ B
            target = self.right[cells, j] - B.T @ right[:, j]
            paired[cells, j] = cho_solve(cho_factor(schur), target)
            paired[:count, j] = right[:, j] - B @ paired[cells, j]
        paired[:count] = back(paired[:count])
        return self._centred(plain), self._centred(paired)

    def _centred(self, out: Array) -> Array:
        for a, b in zip(self.tables.starts, self.tables.starts[1:], strict=False):
            out[a:b] -= (self.share[a:b] @ out[a:b]) * out[a:b].any(axis=0)
        return out

    def build_lookup_tables(self, coefficients: Array) -> tuple[list[LevelAxis], list[LookupTable]]:
        """Return coefficients as tables, those that are zero left out.

        Loads are variables behind all states, in the order of the joints.
        """
        states, loads = self.tables.states, self.tables.load_levels
        cut = np.split(coefficients, self.tables.starts[1:-1])
        axes = [LevelAxis(i, edges) for i, edges in enumerate(states.edges)]
        count = len(axes)
        out = [LookupTable((i,), make_read_only(t)) for i, t in enumerate(cut[:count]) if t.any()]
        for j, values in enumerate(cut[count:]):
            if not values.any():
                continue
            sizes = loads.sizes[2 * j : 2 * j + 2]
            place, values = len(axes), values.reshape(*sizes, -1)
            out.append(LookupTable((place, place + 1), make_read_only(values.copy())))
            axes.append(LevelAxis(self.tables.speed_columns[j], loads.edges[2 * j]))
            axes.append(LevelAxis(count + j, loads.edges[2 * j + 1]))
        return axes, out


def sum_table_rows(tables: TableColumns, Z: csr_matrix, Y: Array) -> TableRegression:
    """Sum up rows: their columns Z of the tables, and responses Y [N m] (n, j)."""
    n, y_mean = Z.shape[0], Y.mean(axis=0)
    share, right = np.asarray(Z.sum(axis=0)).ravel() / n, Z.T @ (Y - y_mean)
    gram = (Z.T @ Z).toarray() - n * np.outer(share, share)
    return TableRegression(tables, gram, share, right, y_mean, n)
