"""Schemes of validation, and the errors of every model under each of them.

RMSEC and RMSEV are 100 ||Y* - Yhat|| / ||Y*|| on the rows that a fold fitted and on
those that it held out (paper, eq. 29), Y* the measured torque. On measured motion a
joint has rows only where it moves (`TrainingRows.with_fitted_standstill` says why).

The paper's systematic and random schemes hold out rows whose neighbors, or whose
repetition a period later, stay in the training set: they measure memory of the path.
Runs and families held out measure what the model knows of motion that it never saw.
"""

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from residual.calibration.calibration_rows import FEW, CalibrationRows
from residual.calibration.correction_choice import (
    LEAST_SQUARES,
    NONE,
    CorrectionOption,
    TrainingRows,
    add_errors_by_second,
    choose_joint_options,
    fit_all_corrections,
)
from residual.calibration.correction_choice import PLSR as LINES
from residual.calibration.nominal_pls import NominalPlsForm, fit_nominal_pls
from residual.calibration.table_regression import TableColumns, count_column_pairs
from residual.errors import InputError
from residual.quantity import check_count, check_varying, make_read_only
from residual.recording import Array

BLOCKS = 20  # paper, section 2.5.2
RUN, BLOCK, FAMILY, SYSTEMATIC = "run", "block", "family", "systematic"
RANDOM = "random"
SCHEMES = {
    RUN: "leave one run out",
    BLOCK: "leave one block of a run out",
    FAMILY: "leave one family out",
    SYSTEMATIC: f"systematic {BLOCKS}",
    RANDOM: f"random {BLOCKS}",
}
NOTHING, LS, PLSR, PAPER_FORM, DEFAULT = "none", "ls", "plsr", "paper", "default"
MODELS = {
    NOTHING: "no compensation",
    LS: "LS",
    PLSR: "PLSR",
    PAPER_FORM: "paper form",
    DEFAULT: "default form",
}
# Variables from which on the paper's form is fitted for unseen runs alone: six joints
# have four times the pairs of three, and forty folds of rows would take a minute.
WIDE = 12

# What a model leaves on all rows when it is identified without some blocks. (n, j).
Response = Callable[[Collection[int]], Array]


@dataclass(frozen=True, eq=False, slots=True)
class Folds:
    """Which rows are held out together."""

    of_row: Array  # fold of each row, (n,)
    names: tuple[str, ...]  # name of each fold, such as the run left out

    @property
    def count(self) -> int:
        """Number of folds."""
        return len(self.names)


def compute_relative_error(squared_error: Array, power: Array) -> Array:
    """Return 100 ||Y* - Yhat|| / ||Y*|| (paper, eq. 29) [%]; NaN without torque."""
    some = np.where(power > 0, power, np.nan)
    return 100 * np.sqrt(np.maximum(squared_error, 0) / some)


def build_label_folds(labels: Array) -> Folds:
    """Hold out all rows of one label at a time: of one run, or of one family."""
    names, of_row = np.unique(labels, return_inverse=True)
    remedy = "Take more logs, or cut a long one into parts with windows."
    check_count(len(names), 2, len(labels), "number of different runs", remedy)
    return Folds(make_read_only(of_row.reshape(-1)), tuple(map(str, names)))


def build_contiguous_folds(rows: int, blocks: int = BLOCKS) -> Folds:
    """Hold out one block of consecutive rows at a time (paper, section 2.5.2)."""
    return _in_blocks(np.arange(rows) * blocks // max(rows, 1), blocks)


def draw_random_folds(
    rows: int, rng: np.random.Generator, blocks: int = BLOCKS
) -> Folds:
    """Hold out randomly drawn rows, equally many each time (paper, section 2.5.3)."""
    return _in_blocks(rng.permutation(rows) % blocks, blocks)


def sum_by_fold(values: Array, folds: Folds) -> Array:
    """Sum of each column over the rows of each fold. Shapes (n, j), (folds, j)."""
    columns = [np.bincount(folds.of_row, v, folds.count) for v in values.T]
    return np.stack(columns, axis=1)


def _in_blocks(of_row: Array, blocks: int) -> Folds:
    remedy = f"There are {len(of_row)} rows: take longer logs or fewer blocks."
    check_count(blocks, 2, len(of_row), "blocks", remedy)
    return Folds(make_read_only(of_row), tuple(f"block {i + 1}" for i in range(blocks)))


@dataclass(frozen=True, eq=False, slots=True)
class ValidationScheme:
    """One scheme.

    Attributes:
        name: Key of `SCHEMES`.
        folds: Which rows are held out together.
        left_out: Blocks that the nominal model of each fold must not see; none of them
            where rows are held out.
    """

    name: str
    folds: Folds
    left_out: tuple[frozenset[int], ...]

    @property
    def unseen(self) -> bool:
        """Whether nominal model and choice have not seen what is held out."""
        return any(self.left_out)

    def split(self, rows: CalibrationRows) -> Iterator[tuple[Array, Array]]:
        """Yield the rows that each fold fits, and those that it holds out. (n,)."""
        for fold, left_out in enumerate(self.left_out):
            held_out = self.folds.of_row == fold
            # What is close to a block is neither.
            kept = (
                rows.blocks.mask_kept_rows(rows.place, left_out)
                if left_out
                else ~held_out
            )
            yield kept, held_out


def build_validation_schemes(
    rows: CalibrationRows, rng: np.random.Generator
) -> tuple[tuple[ValidationScheme, ...], tuple[str, ...]]:
    """Return the schemes that these rows allow, and why others are left out."""
    if len(rows.labels) < 2:
        raise InputError("One run: expected two or more to leave one out.")
    for number, label in enumerate(rows.labels):
        kept = rows.X[rows.run != number]
        check_varying(kept, rows.names, f"all but run {label},")
    run_of, notes = rows.blocks.runs, []
    out = [_unseen(RUN, rows.run, [{i} for i in range(len(rows.labels))], run_of)]
    if len(rows.labels) < FEW:
        alone = [frozenset([i]) for i in range(len(run_of))]
        out.append(
            ValidationScheme(BLOCK, build_label_folds(rows.place // 3), tuple(alone))
        )
        notes.append(
            f"{len(rows.labels)} runs are few: blocks within them are left out too, "
            "which asks less, and the choice that is judged on an unseen run is made "
            "on blocks"
        )
    families = sorted(set(rows.families))
    if len(families) > 1 and "" not in families:
        of_run = [families.index(f) for f in rows.families]
        numbers = range(len(families))
        runs = [{i for i, f in enumerate(of_run) if f == n} for n in numbers]
        out.append(_unseen(FAMILY, np.array(of_run)[rows.run], runs, run_of))
    else:
        only = len(families) == 1 and families[0]
        unknown = "the kind of motion of the logs is not known"
        notes.append(
            f"no family left out: {'all runs are of one' if only else unknown}"
        )
    by_rows = (build_contiguous_folds(len(rows.X)), draw_random_folds(len(rows.X), rng))
    for name, folds in zip((SYSTEMATIC, RANDOM), by_rows, strict=True):
        # A few dozen parameters from thousands of rows do not know one block of them.
        out.append(ValidationScheme(name, folds, (frozenset(),) * folds.count))
    return tuple(out), tuple(notes)


def _unseen(
    name: str, label: Array, runs: Sequence[set], run_of: Array
) -> ValidationScheme:
    left_out = [np.flatnonzero(np.isin(run_of, list(group))).tolist() for group in runs]
    return ValidationScheme(
        name, build_label_folds(label), tuple(map(frozenset, left_out))
    )


@dataclass(frozen=True, eq=False, slots=True)
class SchemeErrors:
    """Squared errors of every form under one scheme [N^2 m^2].

    Attributes:
        scheme: The scheme.
        options: Options that were tried.
        fitted, held_out: On rows fitted and held out, by option. (folds, options, j).
        paper_fitted_errors, paper_held_out_errors: The same of the paper's form with 0
            to A components; None where it was not fitted.
        fitted_power, power: Squared torque of the rows. (folds, j).
        seconds: On rows held out, per second. (options, seconds, j).
        forecasts: Corrections of the rows of one fold, by option, and by all
            components of the paper's form; None where no fold was asked for.
    """

    scheme: ValidationScheme
    options: tuple[CorrectionOption, ...]
    fitted: Array
    held_out: Array
    paper_fitted_errors: Array | None
    paper_held_out_errors: Array | None
    fitted_power: Array
    power: Array
    seconds: Array
    forecasts: tuple[Array, Array] | None


def cross_validate_corrections(
    scheme: ValidationScheme,
    rows: CalibrationRows,
    compute_residuals: Response,
    tables: TableColumns,
    options: Sequence[CorrectionOption],
    paper_form: NominalPlsForm | None,
    shown_fold: int | None = None,
) -> SchemeErrors:
    """Fit all forms without each fold, and judge them on that fold.

    Args:
        compute_residuals: What a nominal model leaves that was identified without some
            blocks.
        options: What a joint may get.
        paper_form: The paper's form; None to leave it out.
        shown_fold: A fold whose corrections are kept.
    """
    fitted, held_out, power_fitted, paper, forecasts = [], [], [], [], None
    every = counts = once = None
    seconds = np.zeros((len(options), int(rows.second.max()) + 1, len(rows.joints)))
    for fold, (kept, out) in enumerate(scheme.split(rows)):
        Y = compute_residuals(scheme.left_out[fold])
        if every is None or scheme.unseen:
            every = build_training_rows(rows, Y, tables)
            counts = None if scheme.unseen else count_column_pairs(every.Z)
            # What stands says what all rows in motion say, where rows are held out.
            once = (
                None
                if scheme.unseen or paper_form is not None
                else every.with_fitted_standstill()
            )
        fit_rows, new = every.rows(kept), every.rows(out)
        training = (
            fit_rows.with_fitted_standstill() if once is None else once.rows(kept)
        )
        pair_sums = None
        if counts is not None:  # of few rows less than of many
            pair_sums = partial(
                lambda n, Z: n - count_column_pairs(Z), counts, every.Z[out]
            )
        fits = fit_all_corrections(training, tables, pair_sums)
        predicted = fits.forecasts(new, options)
        fitted.append(_squares(fit_rows, fits.forecasts(fit_rows, options)))
        held_out.append(_squares(new, predicted))
        power_fitted.append(
            fit_rows.squared_errors(fit_rows.Y - fit_rows.tau).sum(axis=0)
        )
        add_errors_by_second(seconds, new, predicted)
        if paper_form is not None:
            by_count = fit_paper_forecast(training, paper_form)
            paper.append([_squares(part, by_count(part)) for part in (fit_rows, new)])
            if fold == shown_fold:
                forecasts = predicted, by_count(new)[-1]
    both = (None, None)
    if paper_form is not None:
        both = tuple(map(np.array, zip(*paper, strict=True)))
    torque = rows.tau * rows.moving
    return SchemeErrors(
        scheme,
        tuple(options),
        np.array(fitted),
        np.array(held_out),
        *both,
        np.array(power_fitted),
        sum_by_fold(torque * torque, scheme.folds),
        seconds,
        forecasts,
    )


def build_training_rows(
    rows: CalibrationRows, Y: Array, tables: TableColumns
) -> TrainingRows:
    """Return all rows with what some nominal model leaves [N m]. Shape (n, j)."""
    moving = None if rows.moving.all() else rows.moving
    Z = tables.encode(rows.X, rows.tau - Y)
    return TrainingRows(rows.X, Y, rows.tau, rows.second, Z, moving)


def fit_paper_forecast(
    rows: TrainingRows, form: NominalPlsForm
) -> Callable[[TrainingRows], Array]:
    """Fit the paper's form to rows as taught; predict by 0 to A components.

    Where the rows bear fewer, the last comes again. Shapes (A + 1, m, j).
    """
    model = fit_nominal_pls(rows.X, rows.Y, form, allow_fewer_components=True)

    def predict(new: TrainingRows) -> Array:
        T = model.transform(new.X)
        out = np.empty((form.components + 1, *new.Y.shape))
        out[0] = model.y_mean
        for a in range(form.components):
            out[a + 1] = out[a]
            if a < T.shape[1]:
                out[a + 1] += np.outer(T[:, a], model.Q[a])
        return out

    return predict


def _squares(rows: TrainingRows, predicted: Array) -> Array:
    """Squared error of every choice. Shape (c, m, j) to (c, j)."""
    return np.stack([rows.squared_errors(p).sum(axis=0) for p in predicted])


@dataclass(frozen=True, eq=False, slots=True)
class ModelScore:
    """One cell of the table.

    Attributes:
        scheme, model: Their names.
        rmsec, rmsev: Pooled over folds [%]. Shapes (j,).
        mean: RMSEV as the paper takes it, the mean over folds [%]. Shape (j,).
        components: Components A_opt, None for a model that has none.
        curve: RMSEV over components, from none on [%]. Shape (A + 1, j), or None.
        miss, power: Squared error and squared torque per fold [N^2 m^2]. (folds, j).
    """

    scheme: str
    model: str
    rmsec: Array
    rmsev: Array
    mean: Array
    components: int | None
    curve: Array | None
    miss: Array
    power: Array

    @property
    def overall(self) -> float:
        """RMSEV over all joints together [%]."""
        return float(compute_relative_error(self.miss.sum(), self.power.sum()))


def choose_fold_options(
    trial: SchemeErrors, deciding_trial: SchemeErrors, rows: CalibrationRows
) -> list[tuple[CorrectionOption, ...]]:
    """Return each fold's option of each joint: chosen by what others were held out.

    Args:
        deciding_trial: The trial to choose by, which left out runs, or blocks of few
            of them.
    """
    out = []
    for left_out in trial.scheme.left_out:
        gone = np.isin(rows.place // 3, list(left_out))
        counted = np.ones(deciding_trial.seconds.shape[1])
        counted[rows.second[gone]] = 0
        out.append(
            choose_joint_options(
                deciding_trial.seconds * counted[:, None], deciding_trial.options
            )
        )
    return out


def score_models(
    trial: SchemeErrors, chosen: Sequence[Sequence[CorrectionOption]]
) -> list[ModelScore]:
    """Return the cells of the table of one scheme, given each fold's choice."""
    place = {option: i for i, option in enumerate(trial.options)}
    nothing, line = (
        place[CorrectionOption(NONE)],
        place[CorrectionOption(LEAST_SQUARES)],
    )
    # With all components PLSR is least squares.
    lines = [i for option, i in place.items() if option.kind == LINES] + [line]
    both, out = (trial.fitted, trial.held_out), []
    for name, at in ((NOTHING, [nothing]), (LS, [line]), (PLSR, lines)):
        out.append(_score(trial, name, *(part[:, at] for part in both)))
    if trial.paper_held_out_errors is not None:
        out.append(
            _score(
                trial,
                PAPER_FORM,
                trial.paper_fitted_errors,
                trial.paper_held_out_errors,
            )
        )
    numbers = np.array([[[place[o] for o in default]] for default in chosen])
    default = (np.take_along_axis(part, numbers, axis=1) for part in both)
    return [*out, _score(trial, DEFAULT, *default)]


def _score(trial: SchemeErrors, model: str, fitted: Array, unseen: Array) -> ModelScore:
    power = trial.power
    curve = compute_relative_error(unseen.sum(axis=0), power.sum(axis=0))
    best, counted = 0, model in (PLSR, PAPER_FORM)
    if counted:
        # A_opt as in the paper: at least one component, by this validation itself.
        best = 1 + int(np.nansum(curve[1:] ** 2, axis=1).argmin())
    power_fitted = trial.fitted_power.sum(axis=0)
    rmsec = compute_relative_error(fitted[:, best].sum(axis=0), power_fitted)
    by_fold = compute_relative_error(unseen[:, best], power)
    return ModelScore(
        trial.scheme.name,
        model,
        rmsec,
        curve[best],
        np.nanmean(by_fold, axis=0),
        best if counted else None,
        curve if counted else None,
        unseen[:, best],
        power,
    )


def find_model_score(
    scores: Sequence[ModelScore], scheme: str, model: str
) -> ModelScore | None:
    """Return one cell of the table, None where it is not there."""
    same = (s for s in scores if (s.scheme, s.model) == (scheme, model))
    return next(same, None)
