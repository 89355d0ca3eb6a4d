"""What the paper's figures show beside the table: components, levels, one run."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from time import process_time

import numpy as np

from residual.calibration.calibration_rows import (
    CalibrationRows,
    CalibrationRun,
    name_state_columns,
)
from residual.calibration.correction_choice import LEAST_SQUARES, CorrectionOption, TableColumns
from residual.calibration.nominal_pls import NominalPlsForm
from residual.calibration.validation_scores import (
    DEFAULT,
    LS,
    PAPER_FORM,
    SchemeErrors,
    ValidationScheme,
    build_training_rows,
    compute_relative_error,
    fit_paper_forecast,
)
from residual.errors import InputError
from residual.quantity import (
    check_block,
    check_column_names,
    check_count,
    check_varying,
    make_read_only,
)
from residual.recording import Array
from residual.signals.filters import randomise_phases

LEAST_DRAWS = 20  # a 95 % limit from fewer is their maximum
_QUANTILE = 0.95  # of the surrogates, that chance may not exceed


@dataclass(frozen=True, eq=False, slots=True)
class PrincipalComponents:
    """Principal components of centred, scaled columns (paper, eq. 12, figures 4 to 6).

    Attributes:
        names: The columns.
        loadings: Orthonormal loadings P, by column. Shape (k, k).
        explained: Share of the variance per component [%]. Shape (k,).
        limit: What 95 of 100 surrogates with the same spectra do not exceed [%]. (k,).
        family, block: Kind of motion and block of a calibration.
    """

    names: tuple[str, ...]
    loadings: Array
    explained: Array
    limit: Array
    family: str = ""
    block: str = ""

    @property
    def real(self) -> int:
        """Number of leading components with more variance than chance gives.

        In a correlation matrix a first component too large makes the others small, so
        only an unbroken start is a count.
        """
        return int(np.logical_and.accumulate(self.explained > self.limit).sum())

    def strongest(self, component: int) -> tuple[tuple[str, float], ...]:
        """The three variables with the largest loadings of a component, with sign."""
        column = self.loadings[:, component]
        order = np.argsort(-np.abs(column), kind="stable")[:3]
        return tuple((self.names[i], float(column[i])) for i in order)


def fit_pca(
    X: Array,
    rng: np.random.Generator,
    names: Sequence[str] | None = None,
    *,
    run_of_row: Array | None = None,
    surrogate_count: int = 100,
) -> PrincipalComponents:
    """Return all principal components of signals as columns, in any units.

    The columns are centred and scaled to unit variance first (paper, below eq. 12):
    angles, speeds and accelerations have different units. The largest loading of each
    component is positive. Surrogates are drawn within runs.

    How many components are more than chance: parallel analysis (Horn 1965,
    Psychometrika 30) compares with white noise. Rows of a log are autocorrelated: two
    slow signals of no relation correlate by chance. So chance is drawn with the
    spectrum of every variable kept (Theiler et al. 1992, Physica D 58).
    """
    X = check_block(X, "X")
    least = max(2, X.shape[1])
    check_count(len(X), least, 2**62, "rows of X", "Take a longer log.")
    names = check_column_names(names, X.shape[1], "x")
    check_varying(X, names)
    check_count(surrogate_count, LEAST_DRAWS, 10**6, "draws", "100 are usual.")
    run_of_row = np.zeros(len(X), int) if run_of_row is None else np.asarray(run_of_row)
    if run_of_row.shape != (len(X),):
        raise InputError(f"run has shape {run_of_row.shape}, expected ({len(X)},).")
    parts = [np.flatnonzero(run_of_row == label) for label in np.unique(run_of_row)]
    shortest = min(map(len, parts))
    check_count(shortest, 4, len(X), "rows of a run", "Leave short runs out.")
    from sklearn.decomposition import PCA
    from sklearn.preprocessing import StandardScaler

    scaled = StandardScaler().fit_transform(X)
    pca = PCA(svd_solver="covariance_eigh").fit(scaled)
    spectra = [np.fft.rfft(X[rows] - X[rows].mean(0), axis=0) for rows in parts]
    means = np.concatenate([np.repeat(X[r].mean(0)[None], len(r), 0) for r in parts])
    drawn = np.empty((surrogate_count, X.shape[1]))
    for i in range(surrogate_count):
        pairs = zip(spectra, parts, strict=True)
        new = [randomise_phases(s, len(rows), rng) for s, rows in pairs]
        correlation = np.corrcoef((np.concatenate(new) + means).T).reshape(X.shape[1], -1)
        drawn[i] = np.linalg.eigvalsh(correlation)[::-1]
    limit = np.quantile(drawn, _QUANTILE, axis=0)
    # Variances of n rows are over n, as in a correlation matrix, and not over n - 1.
    values = pca.explained_variance_ * (len(X) - 1) / len(X)
    shares = (100 * v / X.shape[1] for v in (values, limit))
    ordered = pca.components_.T.copy(), *shares
    return PrincipalComponents(names, *map(make_read_only, ordered))


INPUT, TWIN, WHITE, LEFT = "input", "twin error", "white noise", "residual"
SWEEP = (2, 4, 8, 15, 22, 40)  # levels
_COMPONENTS, _FOLDS = 15, 4  # of the sweep; so many folds say what all do
_DRAWS, _MOST_ROWS = 40, 1500  # of surrogates; more rows do not move the limit
_MOST = 600  # rows of a picture
_TWIN_STATE = ("e_q", "e_qd", "e_qdd")


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
    """A run that no model has seen, over time (paper, figure 9).

    Attributes:
        label: The run.
        t: Time from its first row [s]. Shape (n,).
        residual: Of a nominal model that has not seen the run [N m]. Shape (n, j).
        corrections: Torque of each model's correction [N m]. Shapes (n, j).
    """

    label: str
    t: Array
    residual: Array
    corrections: Mapping[str, Array]


def find_median_error_run(rows: CalibrationRows) -> int:
    """Return the number of the run of the middle error."""
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
    """Return a run with its corrections by models that were fitted without it.

    Args:
        trial: By run; its forecasts are of this one.
        residual: Of a nominal model that has not seen it, on all rows. (n, j).
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
    """Validate every number of levels, on what the first folds of schemes hold out."""
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


def analyze_principal_components(
    rows: CalibrationRows, runs: Sequence[CalibrationRun], rng: np.random.Generator
) -> tuple[PrincipalComponents, ...]:
    """Principal components of input, error and white noise, family by family.

    Where the logs do not say their family, all runs are one.
    """
    out = []
    families = rows.families if all(rows.families) else ("all runs",) * len(runs)
    for family in dict.fromkeys(families):
        members = [i for i, f in enumerate(families) if f == family]
        taken = [np.flatnonzero(rows.run == i) for i in members]
        step = max(1, sum(map(len, taken)) // _MOST_ROWS)
        taken = [part[::step] for part in taken]
        chosen = np.concatenate(taken)
        X = rows.X[chosen]
        blocks = {
            INPUT: (X, rows.names),
            **_error_block(rows, runs, dict(zip(members, taken, strict=True))),
            WHITE: (rng.normal(size=X.shape), rows.names),
        }
        for name, (values, names) in blocks.items():
            options = {"run_of_row": rows.run[chosen], "surrogate_count": _DRAWS}
            pca = fit_pca(values, rng, names, **options)
            out.append(replace(pca, family=family, block=name))
    return tuple(out)


def _error_block(
    rows: CalibrationRows, runs: Sequence[CalibrationRun], taken: Mapping[int, Array]
) -> dict[str, tuple[Array, tuple[str, ...]]]:
    """The twin's errors of state at equally many times as rows were taken of each run.

    What a model leaves on these rows where there is no twin.
    """
    if not all(set(_TWIN_STATE) <= set(runs[i].twin) for i in taken):
        residual = rows.Y[np.concatenate([*taken.values()])]
        return {LEFT: (residual, tuple(f"residual{j}" for j in rows.joints))}
    joints, errors = [j - 1 for j in rows.joints], []
    for i, part in taken.items():
        at = np.linspace(0, len(runs[i].log.t) - 1, len(part)).astype(int)
        parts = (runs[i].twin[name][at][:, joints] for name in _TWIN_STATE)
        errors.append(np.hstack([*parts]))
    names = tuple(f"e_{name}" for name in name_state_columns(rows.joints))
    return {TWIN: (np.concatenate(errors), names)}
