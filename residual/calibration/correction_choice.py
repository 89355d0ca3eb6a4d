"""The correction of each joint: the one with the least error on left-out runs or blocks.

One joint gets one of: nothing, PLSR of the states with some components (with none it is
a constant), least squares, a table for each variable, these with one of speed and load.
Each is fitted to the other runs and judged on the one left out, with a nominal model
that was not fitted to it: the residual of a model on runs that it was identified from is
smaller, and of another shape, than on others.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import block_diag, cho_factor, cho_solve, cholesky, solve_triangular
from scipy.sparse import csr_matrix

from residual.calibration.nominal_pls import DWELL, PlsModel, VariableLevels, build_levels, fit_pls
from residual.model.compare import is_error_significant
from residual.model.lookup import NONE, LevelAxis, Lookup, LookupTable
from residual.quantity import check_column_names, make_read_only
from residual.recording import Array

LEVELS, WIDTHS = 20, (1, 2, 4)  # of a variable; number of levels merged in each width
PAIR_LEVELS, PAIR_WIDTHS = 12, (1, 2)  # of speed and of load
RIDGES = (20.0, 200.0, 2000.0)  # per ROWS rows
ROWS = 20_000
LEAST_SQUARES, PLSR = "least squares", "plsr"
MAIN, PAIRS = "main effects", "main effects and load"
# One-sided significance of a correction over none. Omitting one has a price too, so one
# in ten by chance, instead of the hundredth for naming an effect.
LIKELY = 0.9
# Least saving of the tables: even a residual driven by time follows the state by a few
# thousandths.
WORTH = 0.02  # of its squared error


# Our form is a table for each variable, and one of speed and load for each joint.
# Friction is a function of one variable: a table of the velocity holds it on any path,
# while the paper's pair tables would need data at every value of the others. The one
# pair of variables with a physical reason is speed and load: friction of a gear grows with
# the torque that it carries, which is known from the model. Its table is fitted together
# with the others: fitted after them, it would find the load already explained as a
# function of the path.
#
# All tables are fitted by one ridge regression on levels of several widths at once:
#
#     min |Y - ybar - (Z - zbar) g|^2 + ridge n / 20000 g' K^-1 g
#
# with Z a column per level and K the number of widths in which two levels are merged. Wide
# levels dominate where rows are few, narrow ones where they are many.


@dataclass(frozen=True, eq=False, slots=True)
class TableColumns:
    """The columns of fitted tables: levels of the variables, and of speeds and loads.

    Columns of Z are the levels of the variables, then the cells of each joint's table.
    """

    states: VariableLevels
    load_levels: VariableLevels  # speed and load of each joint, alternating
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
    """Choose levels from rows of states and loads, independent of the responses.

    Args:
        X: States. Shape (n, d).
        loads: Model torque of each joint [N m]. Shape (n, j).
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
    """Return which levels are merged for a given width. Shape (k, k)."""
    level, still = np.arange(len(edges) + 1), np.flatnonzero(edges == -DWELL)
    group = level // width
    if len(still):  # the two directions, and standstill, stay separate
        level = level - (still[0] + 1)
        group = np.sign(level) * np.ceil(np.abs(level) / width)
    return (group[:, None] == group[None, :]).astype(float)


@dataclass(frozen=True, slots=True)
class CorrectionOption:
    """One choice for one joint."""

    kind: str  # one of the five constants
    ridge: float | None = None  # of tables, per 20 000 rows
    count: int = 0  # components of PLSR


def list_correction_options(variable_count: int) -> tuple[CorrectionOption, ...]:
    """Return the options of a joint for a number of states, nothing first."""
    lines = [CorrectionOption(PLSR, count=a) for a in range(variable_count)]
    tables = [CorrectionOption(kind, ridge) for kind in (MAIN, PAIRS) for ridge in RIDGES]
    return (CorrectionOption(NONE), *lines, CorrectionOption(LEAST_SQUARES), *tables)


@dataclass(frozen=True, eq=False, slots=True)
class TrainingRows:
    """Rows to fit.

    Attributes:
        X: States. Shape (n, d).
        Y: Residual of the nominal model [N m]. Shape (n, j).
        tau: Measured torque [N m]. Shape (n, j).
        second: Second of each row, numbered over all runs. Shape (n,).
        Z: Columns of the tables (`TableColumns`) on the rows.
        moving: Whether a row counts for a joint; None where all do. Shape (n, j), bool.
    """

    X: Array
    Y: Array
    tau: Array
    second: Array
    Z: csr_matrix
    moving: Array | None = None

    def rows(self, chosen: Array) -> "TrainingRows":
        """Return a selection of the rows."""
        parts = (self.X, self.Y, self.tau, self.second, self.Z, self.counted)
        return TrainingRows(*(part[chosen] for part in parts))

    @property
    def counted(self) -> Array:
        """Whether a row counts for a joint. Shape (n, j), bool."""
        every = np.ones(self.Y.shape, bool)
        return every if self.moving is None else self.moving

    def squared_errors(self, predicted: Array) -> Array:
        """Squared errors [N^2 m^2], none where a joint stands. Shape (n, j)."""
        return (self.Y - predicted) ** 2 * self.counted

    def with_fitted_standstill(self) -> "TrainingRows":
        """Return the rows with values at standstill replaced by a fit in motion.

        Friction at standstill may take any value up to breakaway: from such rows a
        table of speed memorizes one reversal, and applies it at every other one. They
        are replaced by a line and a step in the joint's own speed, fitted to the rows
        in motion, so that tables follow the typical friction there.
        """
        if self.moving is None or self.moving.all():
            return self
        Y, speeds = self.Y.copy(), self.X.shape[1] // 3
        for j, moves in enumerate(self.moving.T):
            X = np.column_stack([self.X, np.sign(self.X[:, speeds + j])])
            if moves.any():
                offset, slope = fit_linear(X[moves], self.Y[moves][:, [j]])
                Y[~moves, j] = (offset + X[~moves] @ slope)[:, 0]
            else:
                Y[:, j] = 0.0
        return replace(self, Y=Y)


@dataclass(frozen=True, eq=False, slots=True)
class CorrectionFits:
    """All forms, fitted to the same rows; each ridge is solved on demand."""

    line: tuple[Array, Array]  # least squares: constant (j,), slope (d, j)
    pls: PlsModel
    tables: TableColumns
    gram: Array  # centred Z'Z, (k, k)
    share: Array  # share of the rows in each column of Z, (k,)
    right: Array  # Z'(Y - ybar), (k, j)
    y_mean: Array  # mean of the responses, (j,)
    rows: int
    solved: dict[float, tuple[Array, Array]] = field(default_factory=dict)

    def forecasts(self, rows: TrainingRows, options: Sequence[CorrectionOption]) -> Array:
        """Return the corrections of rows for each option, the same on all joints.

        In N m. Shape (options, m, j).
        """
        offsets, slopes = zip(*map(self._line, options), strict=True)
        lines = (rows.X @ np.hstack(slopes)).reshape(len(rows.X), len(options), -1)
        out = np.array(offsets)[:, None] + lines.transpose(1, 0, 2)
        tabled = [i for i, option in enumerate(options) if option.ridge is not None]
        if tabled:
            each = [self._coefficients(options[i]) for i in tabled]
            read = (rows.Z @ np.hstack(each)).reshape(len(rows.X), len(tabled), -1)
            out[tabled] += read.transpose(1, 0, 2)
        return out

    def lookup(self, options: Sequence[CorrectionOption]) -> Lookup:
        """Return the correction with an option for each joint, as tables.

        Loads become variables, after all states, only if a joint uses them.
        """
        states, loads, joints = self.tables.states, self.tables.load_levels, len(options)
        offset, slope = np.zeros(joints), np.zeros((len(states.names), joints))
        coefficients = np.zeros(self.right.shape)
        for j, option in enumerate(options):
            own_offset, own_slope = self._line(option)
            offset[j], slope[:, j] = own_offset[j], own_slope[:, j]
            if option.ridge is not None:
                coefficients[:, j] = self._coefficients(option)[:, j]
        axes, tables = self._tables(coefficients) if coefficients.any() else ([], [])
        names, low, high = states.names, states.low, states.high
        if any(option.kind == PAIRS for option in options):
            names = (*names, *loads.names[1::2])
            slope = np.vstack([slope, np.zeros((joints, joints))])
            low, high = (np.r_[a, b[1::2]] for a, b in ((low, loads.low), (high, loads.high)))
        responses = check_column_names(None, joints, "joint ")
        linear = (make_read_only(offset), make_read_only(slope), low, high)
        return Lookup(names, responses, tuple(axes), tuple(tables), *linear)

    def _line(self, option: CorrectionOption) -> tuple[Array, Array]:
        """Return the part outside of tables: constant (j,) and slope (d, j)."""
        if option.kind == LEAST_SQUARES:
            return self.line
        if option.kind == PLSR:
            return self.pls.linear(option.count)
        constant = np.zeros_like(self.y_mean) if option.kind == NONE else self.y_mean
        return constant, np.zeros_like(self.line[1])

    def _coefficients(self, option: CorrectionOption) -> Array:
        """Contribution of each column of Z to each response [N m]. Shape (k, j).

        Those of each table have mean zero over the rows.
        """
        if option.ridge not in self.solved:
            self.solved[option.ridge] = self._solve(option.ridge * self.rows / ROWS)
        return self.solved[option.ridge][int(option.kind == PAIRS)]

    def _solve(self, stiff: float) -> tuple[Array, Array]:
        """Coefficients without the tables of speed and load, and with them.

        With A = L L' the system of the variables alone and B that part of a joint's
        cells, the cells solve a Schur complement of the size of B.
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

    def _tables(self, coefficients: Array) -> tuple[list[LevelAxis], list[LookupTable]]:
        """Return coefficients as tables, those that are zero left out."""
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


def fit_all_corrections(rows: TrainingRows, tables: TableColumns) -> CorrectionFits:
    """Fit all forms to training rows."""
    lines = [
        fit_linear(rows.X[moves], rows.Y[moves][:, [j]]) for j, moves in enumerate(rows.counted.T)
    ]
    offset, slope = (np.concatenate(part, axis=-1) for part in zip(*lines, strict=True))
    Z, n, y_mean = rows.Z, rows.Z.shape[0], rows.Y.mean(axis=0)
    share, right = np.asarray(Z.sum(axis=0)).ravel() / n, Z.T @ (rows.Y - y_mean)
    gram = (Z.T @ Z).toarray() - n * np.outer(share, share)
    pls = fit_pls(rows.X, rows.Y)
    return CorrectionFits((offset, slope), pls, tables, gram, share, right, y_mean, n)


def fit_linear(X: Array, Y: Array) -> tuple[Array, Array]:
    """Least squares of Y: a constant (j,), and coefficients of X's columns (d, j).

    Uses products of columns: a tenth of the time, half of the digits.
    """
    mean, scale = X.mean(axis=0), X.std(axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    Z, centred = (X - mean) / scale, Y - Y.mean(axis=0)
    slope = np.linalg.lstsq(Z.T @ Z, Z.T @ centred, rcond=None)[0] / scale[:, None]
    return Y.mean(axis=0) - mean @ slope, slope


def choose_joint_options(
    squared_errors: Array, options: Sequence[CorrectionOption], least_saving: float = 0.0
) -> tuple[CorrectionOption, ...]:
    """Return the best option of each joint; nothing, the first, if its gain may be chance.

    Args:
        squared_errors: Squared errors on rows left out, per second. (options, seconds,
            j).
        least_saving: Least share of the error without correction that the best saves.
    """
    total, chosen = squared_errors.sum(axis=1), []
    for j, i in enumerate(total.argmin(axis=0)):
        pays = total[i, j] < (1 - least_saving) * total[0, j]
        sure = is_error_significant(squared_errors[0, :, j], squared_errors[i, :, j], LIKELY)
        chosen.append(options[i if pays and sure else 0])
    return tuple(chosen)


def fit_chosen_tables(
    rows: TrainingRows, group: Array, tables: TableColumns
) -> tuple[Lookup, tuple[CorrectionOption, ...]]:
    """Fit the options with the least error on left-out groups; uses no nominal model.

    Args:
        group: Log, or block of it, of each row; two at least. Shape (n,).
    """
    options = list_correction_options(rows.X.shape[1])
    miss = np.zeros((len(options), int(rows.second.max()) + 1, rows.Y.shape[1]))
    for label in np.unique(group):
        out = group == label
        fits, new = fit_all_corrections(rows.rows(~out), tables), rows.rows(out)
        add_errors_by_second(miss, new, fits.forecasts(new, options))
    chosen = choose_joint_options(miss, options, WORTH)
    return fit_all_corrections(rows, tables).lookup(chosen), chosen


def add_errors_by_second(error_sums: Array, rows: TrainingRows, forecasts: Array) -> None:
    """Sum squared errors of rows per second. (options, seconds, j)."""
    for sums, forecast in zip(error_sums, forecasts, strict=True):
        np.add.at(sums, rows.second, rows.squared_errors(forecast))
