"""Schemes of validation, and the errors of every model under each of them.

RMSEC and RMSEV are 100 ||Y* - Yhat|| / ||Y*|| on the rows that a fold fitted and on
those that it held out (paper, eq. 29), Y* the measured torque. On measured motion a
joint has rows only where it moves (`TrainingRows.with_fitted_standstill` says why).

The paper's systematic and random schemes hold out rows whose neighbors, or whose
repetition a period later, stay in the training set: they measure memory of the path.
Held-out runs and families measure the error on unseen motion.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from time import process_time

import numpy as np

from residual.calibration.calibration_rows import FEW, CalibrationRows
from residual.calibration.correction_choice import (
    LEAST_SQUARES,
    NONE,
    PLSR,
    CorrectionOption,
    TableColumns,
    TrainingRows,
    add_errors_by_second,
    choose_joint_options,
    fit_all_corrections,
)
from residual.calibration.nominal_pls import NominalPlsForm, fit_nominal_pls
from residual.errors import InputError
from residual.quantity import check_count, check_varying
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
NOTHING, LS, PAPER_FORM, DEFAULT = "none", "ls", "paper", "default"
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


def compute_relative_error(squared_error: Array, power: Array) -> Array:
    """Return 100 ||Y* - Yhat|| / ||Y*|| (paper, eq. 29) [%]; NaN without torque."""
    some = np.where(power > 0, power, np.nan)
    return 100 * np.sqrt(np.maximum(squared_error, 0) / some)


@dataclass(frozen=True, eq=False, slots=True)
class ValidationScheme:
    """One scheme.

    Attributes:
        name: Key of `SCHEMES`.
        fold: Fold of each row; the rows of one are held out together. Shape (n,).
        left_out: Blocks that the nominal model of each fold must not see; none of them
            where rows are held out.
    """

    name: str
    fold: Array
    left_out: tuple[frozenset[int], ...]

    @property
    def unseen(self) -> bool:
        """Whether nominal model and choice are independent of the held-out rows."""
        return any(self.left_out)

    def split(self, rows: CalibrationRows) -> Iterator[tuple[Array, Array]]:
        """Yield the fitted and the held-out rows of each fold. (n,)."""
        for fold, left_out in enumerate(self.left_out):
            held_out = self.fold == fold
            # Rows close to a block are neither.
            kept = rows.blocks.mask_kept_rows(rows.place, left_out) if left_out else ~held_out
            yield kept, held_out


def build_validation_schemes(
    rows: CalibrationRows, rng: np.random.Generator
) -> tuple[tuple[ValidationScheme, ...], tuple[str, ...]]:
    """Return the schemes that these rows allow, and why others are omitted."""
    if len(rows.labels) < 2:
        raise InputError("One run: expected two or more to leave one out.")
    for number, label in enumerate(rows.labels):
        kept = rows.X[rows.run != number]
        check_varying(kept, rows.names, f"all but run {label},")
    run_of, notes, count = rows.blocks.runs, [], len(rows.X)
    remedy = f"There are {count} rows: take longer logs."
    check_count(BLOCKS, 2, count, "blocks", remedy)

    def leave_out_runs(name: str, label: Array) -> ValidationScheme:
        groups = (np.flatnonzero(label[run_of] == k) for k in range(label.max() + 1))
        left_out = tuple(frozenset(group.tolist()) for group in groups)
        return ValidationScheme(name, label[rows.run], left_out)

    out = [leave_out_runs(RUN, np.arange(len(rows.labels)))]
    if len(rows.labels) < FEW:
        alone = tuple(frozenset([i]) for i in range(len(run_of)))
        out.append(ValidationScheme(BLOCK, rows.place // 3, alone))
        notes.append(
            f"{len(rows.labels)} runs are few: blocks within them are left out too, "
            "which asks less, and the choice that is judged on an unseen run is made "
            "on blocks"
        )
    families, label = np.unique(rows.families, return_inverse=True)
    if len(families) > 1 and "" not in families:
        out.append(leave_out_runs(FAMILY, label))
    else:
        only = len(families) == 1 and families[0]
        unknown = "the kind of motion of the logs is not known"
        notes.append(f"no family left out: {'all runs are of one' if only else unknown}")
    blocks, drawn = np.arange(count) * BLOCKS // count, rng.permutation(count) % BLOCKS
    # A block of rows hardly affects a few dozen parameters from thousands of rows.
    nothing = (frozenset(),) * BLOCKS
    out.append(ValidationScheme(SYSTEMATIC, blocks, nothing))  # paper, section 2.5.2
    out.append(ValidationScheme(RANDOM, drawn, nothing))  # paper, section 2.5.3
    return tuple(out), tuple(notes)


@dataclass(frozen=True, eq=False, slots=True)
class SchemeErrors:
    """Squared errors of every form under one scheme [N^2 m^2].

    Attributes:
        scheme: The scheme.
        options: Options of a joint, then the paper's form with 0 to A components if
            fitted.
        fitted, held_out: On rows fitted and held out, by option. (folds, options, j).
        fitted_power, power: Squared torque of the rows. (folds, j).
        seconds: On rows held out, per second, of the options of a joint. (options,
            seconds, j).
        forecasts: Corrections of the rows of one fold, by option; None unless
            requested.
    """

    scheme: ValidationScheme
    options: tuple[CorrectionOption, ...]
    fitted: Array
    held_out: Array
    fitted_power: Array
    power: Array
    seconds: Array
    forecasts: Array | None


def cross_validate_corrections(
    scheme: ValidationScheme,
    rows: CalibrationRows,
    compute_residuals: Callable[[frozenset[int]], Array],
    tables: TableColumns,
    options: Sequence[CorrectionOption],
    paper_form: NominalPlsForm | None,
    shown_fold: int | None = None,
) -> SchemeErrors:
    """Fit all forms without each fold, and judge them on that fold.

    Args:
        compute_residuals: Residual on all rows of a nominal model identified without
            some blocks. Shape (n, j).
        options: Options of a joint.
        paper_form: The paper's form; None to omit it.
        shown_fold: A fold whose corrections are kept.
    """
    errors, power_fitted, forecasts = [], [], None
    every = once = None
    seconds = np.zeros((len(options), int(rows.second.max()) + 1, len(rows.joints)))
    for fold, (kept, out) in enumerate(scheme.split(rows)):
        Y = compute_residuals(scheme.left_out[fold])
        if every is None or scheme.unseen:
            every = build_training_rows(rows, Y, tables)
            # Values at standstill come from all moving rows, where rows are held out.
            once = (
                None if scheme.unseen or paper_form is not None else every.with_fitted_standstill()
            )
        fit_rows, new = every.rows(kept), every.rows(out)
        training = fit_rows.with_fitted_standstill() if once is None else once.rows(kept)
        fits = fit_all_corrections(training, tables)
        predicted = [fits.forecasts(part, options) for part in (fit_rows, new)]
        add_errors_by_second(seconds, new, predicted[1])
        if paper_form is not None:
            by_count = fit_paper_forecast(training, paper_form)
            both = zip(predicted, map(by_count, (fit_rows, new)), strict=True)
            predicted = [np.concatenate(pair) for pair in both]
        parts = zip((fit_rows, new), predicted, strict=True)
        errors.append(
            [
                np.stack([part.squared_errors(p).sum(axis=0) for p in of_part])
                for part, of_part in parts
            ]
        )
        power_fitted.append(fit_rows.squared_errors(fit_rows.Y - fit_rows.tau).sum(axis=0))
        if fold == shown_fold:
            forecasts = predicted[1]
    torque, folds = (rows.tau * rows.moving) ** 2, len(scheme.left_out)
    power = [np.bincount(scheme.fold, column, folds) for column in torque.T]
    counts = range(paper_form.components + 1) if paper_form else ()
    return SchemeErrors(
        scheme,
        (*options, *(CorrectionOption(PAPER_FORM, count=a) for a in counts)),
        *map(np.array, zip(*errors, strict=True)),
        np.array(power_fitted),
        np.stack(power, axis=1),
        seconds,
        forecasts,
    )


def build_training_rows(rows: CalibrationRows, Y: Array, tables: TableColumns) -> TrainingRows:
    """Return all rows with the residual of a nominal model [N m]. Shape (n, j)."""
    Z = tables.encode(rows.X, rows.tau - Y)
    return TrainingRows(rows.X, Y, rows.tau, rows.second, Z, rows.moving)


def fit_paper_forecast(rows: TrainingRows, form: NominalPlsForm) -> Callable[[TrainingRows], Array]:
    """Fit the paper's form to training rows; predict with 0 to A components.

    If the rows support fewer, the last one is repeated. Shapes (A + 1, m, j).
    """
    model = fit_nominal_pls(rows.X, rows.Y, form)

    def predict(new: TrainingRows) -> Array:
        T, steps = model.transform(new.X), np.zeros((form.components + 1, *new.Y.shape))
        steps[0] = model.y_mean
        steps[1 : T.shape[1] + 1] = T.T[:, :, None] * model.Q[:, None]
        return np.cumsum(steps, axis=0)

    return predict


@dataclass(frozen=True, eq=False, slots=True)
class ModelScore:
    """One cell of the table.

    Attributes:
        scheme, model: Their names.
        rmsec, rmsev: Pooled over folds [%]. Shapes (j,).
        mean: RMSEV as in the paper, the mean over folds [%]. Shape (j,).
        components: Components A_opt, None for a model without components.
        curve: RMSEV over 0 to A components [%]. Shape (A + 1, j), or None.
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
    """Return each fold's option of each joint, chosen on the other held-out folds.

    Args:
        deciding_trial: The trial for the choice, which left out runs, or blocks if
            runs are few.
    """
    out = []
    for left_out in trial.scheme.left_out:
        gone = np.isin(rows.place // 3, list(left_out))
        counted = np.ones(deciding_trial.seconds.shape[1])
        counted[rows.second[gone]] = 0
        seconds = deciding_trial.seconds * counted[:, None]
        out.append(choose_joint_options(seconds, deciding_trial.options))
    return out


def score_models(
    trial: SchemeErrors, chosen: Sequence[Sequence[CorrectionOption]]
) -> list[ModelScore]:
    """Return the cells of the table of one scheme, given each fold's choice."""
    place = {option: i for i, option in enumerate(trial.options)}
    line = place[CorrectionOption(LEAST_SQUARES)]
    # With all components PLSR is least squares.
    lines = [i for option, i in place.items() if option.kind == PLSR] + [line]
    paper = [i for option, i in place.items() if option.kind == PAPER_FORM]
    forms = {NOTHING: [place[CorrectionOption(NONE)]], LS: [line], PLSR: lines}
    forms |= {PAPER_FORM: paper} if paper else {}
    both = (trial.fitted, trial.held_out)
    out = [_score(trial, k, *(part[:, at] for part in both)) for k, at in forms.items()]
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


def find_model_score(scores: Sequence[ModelScore], scheme: str, model: str) -> ModelScore | None:
    """Return one cell of the table, None if missing."""
    same = (s for s in scores if (s.scheme, s.model) == (scheme, model))
    return next(same, None)


# Further figures of the paper: levels, and one run (figures 9 and 12).


SWEEP = (2, 4, 8, 15, 22, 40)  # levels
_COMPONENTS, _FOLDS = 15, 4  # folds of the sweep, which represent all
_MOST = 600  # rows of a figure


@dataclass(frozen=True, eq=False, slots=True)
class LevelSweep:
    """Errors of the paper's form over the number of levels (paper, figure 12).

    Attributes:
        levels: Levels tried.
        errors: RMSEV by scheme, best of all component counts [%]. Shapes (levels, j).
        seconds: Processor time of each number of levels [s].
    """

    levels: tuple[int, ...]
    errors: Mapping[str, Array]
    seconds: tuple[float, ...]


@dataclass(frozen=True, eq=False, slots=True)
class UnseenRun:
    """A run that no model was fitted to, over time (paper, figure 9).

    Attributes:
        label: The run.
        t: Time from its first row [s]. Shape (n,).
        residual: Of a nominal model not fitted to the run [N m]. Shape (n, j).
        corrections: Torque of each model's correction [N m]. Shapes (n, j).
    """

    label: str
    t: Array
    residual: Array
    corrections: Mapping[str, Array]


def find_median_error_run(rows: CalibrationRows) -> int:
    """Return the number of the run with the median error."""
    runs = range(len(rows.labels))
    size = [float((rows.Y[rows.run == run] ** 2).mean()) for run in runs]
    return int(np.argsort(size)[len(size) // 2])


def build_unseen_run(
    rows: CalibrationRows,
    trial: SchemeErrors,
    number: int,
    residual: Array,
    chosen: Sequence[CorrectionOption],
) -> UnseenRun:
    """Return a run with its corrections by models fitted without it.

    Args:
        trial: By run; its forecasts are of this one.
        residual: Of a nominal model not fitted to it, on all rows. (n, j).
        chosen: Option of each joint, chosen without it.
    """
    in_run, place = rows.run == number, trial.options.index
    step = max(1, int(in_run.sum()) // _MOST)
    default = [trial.forecasts[place(o), :, j] for j, o in enumerate(chosen)]
    corrections = {
        LS: trial.forecasts[place(CorrectionOption(LEAST_SQUARES))],
        PAPER_FORM: trial.forecasts[-1],  # with all components
        DEFAULT: np.stack(default, axis=1),
    }
    t = np.arange(in_run.sum()) / rows.rates[number]
    thin = {name: values[::step] for name, values in corrections.items()}
    return UnseenRun(rows.labels[number], t[::step], residual[in_run][::step], thin)


def sweep_level_counts(
    rows: CalibrationRows,
    schemes: Sequence[ValidationScheme],
    tables: TableColumns,
    components: int,
) -> LevelSweep:
    """Validate every number of levels, on the first folds of each scheme."""
    every, torque = (build_training_rows(rows, rows.Y, tables), (rows.tau * rows.moving) ** 2)
    count = min(components, _COMPONENTS)
    errors: dict[str, list[Array]] = {scheme.name: [] for scheme in schemes}
    spent = []
    for levels in SWEEP:
        start, form = process_time(), NominalPlsForm(levels, count)
        for scheme in schemes:
            miss, power = 0.0, 0.0
            for kept, held_out in islice(scheme.split(rows), _FOLDS):
                new = every.rows(held_out)
                guesses = fit_paper_forecast(every.rows(kept).with_fitted_standstill(), form)(new)
                miss += np.stack([new.squared_errors(g).sum(axis=0) for g in guesses[1:]])
                power += torque[held_out].sum(axis=0)
            curve = compute_relative_error(miss, power)
            best = np.nansum(curve**2, axis=1).argmin()
            errors[scheme.name].append(curve[best])
        spent.append(process_time() - start)
    stacked = {name: np.array(values) for name, values in errors.items()}
    return LevelSweep(SWEEP, stacked, tuple(spent))
