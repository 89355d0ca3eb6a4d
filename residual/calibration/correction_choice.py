"""Which correction each joint gets: what leaves least on runs or blocks left out.

One joint gets one of: nothing, PLSR of the states with some components (with none it is
a constant), least squares, a table for each variable, these with one of speed and load.
Each is fitted to the other runs and judged on the one left out, with a nominal model
that has not seen it: what a model leaves on runs that it was identified from is
smaller, and of another shape, than what it leaves on others.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_matrix

from residual.calibration.nominal_pls import PlsModel, fit_pls
from residual.calibration.table_regression import (
    RIDGES,
    TableColumns,
    TableRegression,
    sum_table_rows,
)
from residual.model.compare import is_error_significant
from residual.model.lookup import NONE, LevelAxis, Lookup, LookupTable
from residual.quantity import check_column_names, make_read_only
from residual.recording import Array

LEAST_SQUARES, PLSR = "least squares", "plsr"
MAIN, PAIRS = "main effects", "main effects and load"
# How surely a correction is better than nothing, one-sided. To take nothing has its
# price too, so one in ten by chance, and not the hundredth that a model is blamed at.
LIKELY = 0.9
# What a model without the tables must leave more, so that the tables are no ornament: a
# residual that time drives follows the state by a few thousandths all the same.
WORTH = 0.02  # of its squared error


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
    """All forms, fitted to the same rows."""

    line: tuple[Array, Array]  # least squares: constant (j,), slope (d, j)
    pls: PlsModel
    effects: TableRegression

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
        states, joints = self.effects.tables.states, len(options)
        offset, slope = np.zeros(joints), np.zeros((len(states.names), joints))
        coefficients = np.zeros(self.effects.right.shape)
        for j, option in enumerate(options):
            own_offset, own_slope = self._line(option)
            offset[j], slope[:, j] = own_offset[j], own_slope[:, j]
            if option.ridge is not None:
                coefficients[:, j] = self._coefficients(option)[:, j]
        axes: list[LevelAxis] = []
        tables: list[LookupTable] = []
        if coefficients.any():
            axes, tables = self.effects.build_lookup_tables(coefficients)
        names, low, high = states.names, states.low, states.high
        if any(option.kind == PAIRS for option in options):
            loads = self.effects.tables.load_levels
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
        mean = self.effects.y_mean
        constant = np.zeros_like(mean) if option.kind == NONE else mean
        return constant, np.zeros_like(self.line[1])

    def _coefficients(self, option: CorrectionOption) -> Array:
        return self.effects.coefficients(option.ridge, option.kind == PAIRS)


def fit_all_corrections(rows: TrainingRows, tables: TableColumns) -> CorrectionFits:
    """Fit all forms to rows as taught; a ridge is solved for when it is asked for."""
    lines = [
        fit_linear(rows.X[moves], rows.Y[moves][:, [j]]) for j, moves in enumerate(rows.counted.T)
    ]
    offset, slope = (np.concatenate(part, axis=-1) for part in zip(*lines, strict=True))
    effects = sum_table_rows(tables, rows.Z, rows.Y)
    return CorrectionFits((offset, slope), fit_pls(rows.X, rows.Y), effects)


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
