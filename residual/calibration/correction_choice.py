"""Which correction each joint gets: what leaves least on runs or blocks left out.

One joint gets one of: nothing, PLSR of the states with some components (with none it is
a constant), least squares, a table for each variable, these with one of speed and load.
Each is fitted to the other runs and judged on the one left out, with a nominal model
that has not seen it: what a model leaves on runs that it was identified from is
smaller, and of another shape, than what it leaves on others.
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

LEVELS, WIDTHS = 20, (1, 2, 4)  # of a variable; levels that are one in each width
PAIR_LEVELS, PAIR_WIDTHS = 12, (1, 2)  # of speed and of load
RIDGES = (20.0, 200.0, 2000.0)  # per ROWS rows
ROWS = 20_000
LEAST_SQUARES, PLSR = "least squares", "plsr"
MAIN, PAIRS = "main effects", "main effects and load"
# How surely a correction is better than nothing, one-sided. To take nothing has its
# price too, so one in ten by chance, and not the hundredth that a model is blamed at.
LIKELY = 0.9
# What a model without the tables must leave more, so that the tables are no ornament: a
# residual that time drives follows the state by a few thousandths all the same.
WORTH = 0.02  # of its squared error


# Our form is a table for each variable, and one of speed and load for each joint.
# Friction is a function of one variable: a table of the velocity holds it on any path,
# while the paper's pair tables would have to see it beside every value of the others. The
# one pair of variables that has a name is speed and load: friction of a gear grows with
# the torque that it carries, and that torque is known, since it is the model's. Its table
# is fitted together with the others: fitted after them it would find that they have
# already learnt the load as a function of the path.
#
# All tables are fitted by one ridge regression on levels of several widths at once:
#
#     min |Y - ybar - (Z - zbar) g|^2 + ridge n / 20000 g' K^-1 g
#
# with Z a column per level and K the number of widths in which two levels are one. Where
# rows are few the wide levels speak, where they are many the narrow ones do.


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


@dataclass(frozen=True, slots=True)
class CorrectionOption:
    """One choice for one joint."""

    kind: str  # one of the five constants
    ridge: float | None = None  # of tables, per 20 000 rows
    count: int = 0  # components of PLSR


def list_correction_options(variable_count: int) -> tuple[CorrectionOption, ...]:
    """Return what a joint may get of so many states, nothing first."""
    lines = [CorrectionOption(PLSR, count=a) for a in range(variable_count)]
    tables = [CorrectionOption(kind, ridge) for kind in (MAIN, PAIRS) for ridge in RIDGES]
    return (CorrectionOption(NONE), *lines, CorrectionOption(LEAST_SQUARES), *tables)


@dataclass(frozen=True, eq=False, slots=True)
class TrainingRows:
    """Rows to fit.

    Attributes:
        X: States. Shape (n, d).
        Y: What the nominal model leaves [N m]. Shape (n, j).
        tau: Measured torque [N m]. Shape (n, j).
        second: Second that each row is in, through all runs. Shape (n,).
        Z: Columns of the tables that the rows are in (`TableColumns`).
        moving: Whether a row counts for a joint; None where all do. Shape (n, j), bool.
    """

    X: Array
    Y: Array
    tau: Array
    second: Array
    Z: csr_matrix
    moving: Array | None = None

    def rows(self, chosen: Array) -> "TrainingRows":
        """Return some of the rows."""
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
        """Return the same where a joint that stands says what it does in motion.

        Friction at standstill may take any value up to breakaway: from such rows a
        table of speed learns one reversal by heart, and an arm that it drives gets that
        at every other one. A line and a step in the joint's own speed, fitted to the
        rows in motion, stand in for them: tables that share such rows with others lean
        on what friction mostly is.
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
    """All forms, fitted to the same rows; a ridge is solved for when it is asked for."""

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
        """Return the corrections of rows if all joints take each of some options.

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

        Loads become variables, after all states, only if a joint takes them.
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
        """What is not in tables: constant (j,) and slope (d, j)."""
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
    """Fit all forms to rows as taught."""
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

    From products of columns: a tenth of the time, half of the digits.
    """
    mean, scale = X.mean(axis=0), X.std(axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    Z, centred = (X - mean) / scale, Y - Y.mean(axis=0)
    slope = np.linalg.lstsq(Z.T @ Z, Z.T @ centred, rcond=None)[0] / scale[:, None]
    return Y.mean(axis=0) - mean @ slope, slope


def choose_joint_options(
    squared_errors: Array, options: Sequence[CorrectionOption], least_saving: float = 0.0
) -> tuple[CorrectionOption, ...]:
    """Return the best option of each joint; the first, nothing, where it may be chance.

    Args:
        squared_errors: Squared errors on rows left out, per second. (options, seconds,
            j).
        least_saving: Share of the error of nothing that the best has to save at least.
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
    """Fit what leaves least on groups left out, in turn; nothing depends on a model.

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
    """Add squared errors of rows to those of each second. (options, seconds, j)."""
    for sums, forecast in zip(error_sums, forecasts, strict=True):
        np.add.at(sums, rows.second, rows.squared_errors(forecast))
