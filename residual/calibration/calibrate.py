"""The paper's chapter on a set of runs: every model under every scheme.

States of the robot, residual of its model, and how well a correction predicts that
residual: on rows of a fitted motion, and on unseen motions. (Sections 2.4 to 2.6 of the
paper; docs/calibration.md.)

A correction that is judged on unseen runs starts from a model that was not fitted to them
either: declared effects and rigid body under a prior whose width the logs choose.
"""

import re
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np

from residual.calibration.calibration_rows import (
    FEW,
    PAPER,
    CalibrationRows,
    CalibrationRun,
    PrincipalComponents,
    RunBlocks,
    analyze_principal_components,
    build_measured_rows,
    build_paper_rows,
    choose_thinning_factor,
    compute_row_times,
    cut_runs_into_blocks,
    cut_single_run,
    select_row_samples,
)
from residual.calibration.correction_choice import (
    MAIN,
    NONE,
    CorrectionOption,
    TableColumns,
    choose_joint_options,
    choose_table_levels,
    fit_all_corrections,
    list_correction_options,
)
from residual.calibration.nominal_pls import NominalPlsForm, fit_nominal_pls
from residual.calibration.validation_scores import (
    BLOCK,
    PAPER_FORM,
    RANDOM,
    RUN,
    SCHEMES,
    WIDE,
    LevelSweep,
    ModelScore,
    SchemeErrors,
    UnseenRun,
    ValidationScheme,
    build_training_rows,
    build_unseen_run,
    build_validation_schemes,
    choose_fold_options,
    cross_validate_corrections,
    find_median_error_run,
    find_model_score,
    score_models,
    sweep_level_counts,
)
from residual.effects.base import EffectTrait
from residual.evidence.design import Design
from residual.evidence.fit import build_fitted_model, fit_jointly, fit_nominal
from residual.evidence.priors import list_first_priors
from residual.model.lookup import (
    NEAREST,
    CorrectedModel,
    JointCorrection,
    Lookup,
    LookupTable,
    TableVariable,
)
from residual.model.model import Model
from residual.model.nominal import (
    FitLogs,
    NominalModel,
    build_free_nominal,
    choose_declared_effects,
    choose_standstill_behaviour,
    prepare_fit_logs,
)
from residual.recording import Array
from residual.robot.robot import Robot
from residual.signals.splitting import choose_spread_pieces
from residual.signals.track import FilterSettings

Progress = Callable[[str, float], None]
# On random rows the error still falls at 30 components; the paper does not say.
PAPER_SETTING = NominalPlsForm(components=30)
_TWIN = "--declared says nothing with --paper: the twin has what its robot declares"
_CUT = "one log only: it was cut into parts, so unseen parts are of the same run"


@dataclass(frozen=True, eq=False, slots=True)
class PreparedRuns:
    """All logs, prepared for one identification per fold.

    Attributes:
        logs: Signals and the range of motion.
        nominal: Start of every identification.
        blocks: Blocks of the logs, which identifications may leave out.
        places: Place of each log's rows in the blocks.
        design: Columns of the nominal model; its folds are those places.
    """

    logs: FitLogs
    nominal: NominalModel
    blocks: RunBlocks
    places: tuple[Array, ...]
    design: Design


def prepare_runs(
    robot: Robot, runs: Sequence[CalibrationRun], declared: Sequence[str] | None
) -> PreparedRuns:
    """Filter all logs once; declared effects are the robot's own list for None."""
    logs = prepare_fit_logs(
        robot, [run.log for run in runs], None, FilterSettings(), split_long=False
    )
    nominal = build_free_nominal(logs, choose_declared_effects(robot, declared))
    blocks = cut_runs_into_blocks([track.t[select_row_samples(track)] for track in logs.tracks])
    numbered = enumerate(map(compute_row_times, logs.tracks))
    places = tuple(blocks.places(run, t) for run, t in numbered)
    design = Design(logs.tracks, nominal.model, labels=list(places))
    return PreparedRuns(logs, nominal, blocks, places, design)


def identify_without_blocks(prepared: PreparedRuns, left_out: Collection[int] = ()) -> Model:
    """Identify the model from all blocks of the runs but some, by number."""
    design, nominal = prepared.design, prepared.nominal
    if left_out:
        folds = prepared.blocks.kept(left_out)  # a last edge may have no rows
        design = design.part(folds[folds < design.folds], detached=True)
    wide = list_first_priors(design, nominal)
    first = fit_nominal(design, wide[-1])
    fits = [fit_jointly(design, p, (), first.counted, None, rounds=4) for p in wide]
    best = build_fitted_model(nominal, max(fits, key=lambda f: f.score))
    tracks = []  # remaining rows of each log
    for track, places in zip(prepared.logs.tracks, prepared.places, strict=True):
        kept = prepared.blocks.mask_kept_rows(places, left_out)
        if kept.all():
            tracks.append(track)
        elif kept.any():
            inner, moving = track.valid & kept, track.moving & kept[:, None]
            tracks.append(replace(track, valid=inner, moving=moving))
    shown = choose_spread_pieces([track.seconds for track in tracks])
    return choose_standstill_behaviour(best, [tracks[i] for i in shown])


@dataclass(frozen=True, slots=True)
class CalibrationSettings:
    """The settings of a calibration.

    Attributes:
        paper: The paper's regressors and twin error, in place of measured motion.
        declared: Effects that the nominal model has; None for the robot's own list.
        form: Levels of the paper's form, and its largest number of components.
        exact_components: Whether the exported tables have exactly that number.
        joints: Joints of X and Y, from 1; None for all, or the paper's.
        with_figures: Whether to compute the data of figures too.
        schemes: Schemes to report; None for all that the rows allow.
    """

    paper: bool = False
    declared: tuple[str, ...] | None = None
    form: NominalPlsForm = PAPER_SETTING
    exact_components: bool = False
    joints: tuple[int, ...] | None = None
    with_figures: bool = True
    schemes: tuple[str, ...] | None = None


@dataclass(frozen=True, eq=False, slots=True)
class Calibration:
    """Look-up tables, and the errors of each form.

    Attributes:
        robot: Name of the robot.
        rows: The rows.
        scores: The table of errors.
        chosen: Option of the default form for each joint.
        proven: Whether there were enough runs for the choice.
        default: The default form on all rows, as tables.
        paper: The paper's form on all rows, as tables.
        components: Its number of components.
        nominal: Nominal model identified from all runs; None in paper mode.
        declared: Effects that the nominal model has.
        blocks, sweep, unseen: For the figures; None or empty without them.
        notes: Remarks, a line each.
    """

    robot: str
    rows: CalibrationRows
    scores: tuple[ModelScore, ...]
    chosen: tuple[CorrectionOption, ...]
    proven: bool
    default: Lookup
    paper: Lookup
    components: int
    nominal: Model | None
    declared: tuple[str, ...]
    blocks: tuple[PrincipalComponents, ...] = ()
    sweep: LevelSweep | None = None
    unseen: UnseenRun | None = None
    notes: tuple[str, ...] = field(default=())

    @property
    def lookup(self) -> Lookup:
        """The tables of this mode: the paper's form, or ours."""
        return self.paper if self.rows.mode == PAPER else self.default


def calibrate(
    robot: Robot,
    runs: Sequence[CalibrationRun],
    settings: CalibrationSettings | None = None,
    progress: Progress | None = None,
) -> Calibration:
    """Fit and validate every model under every scheme.

    Args:
        runs: Its logs; a single one is cut into parts. Beyond 15 min the model is
            identified from all rows, and the tables from every k-th row.

    Raises:
        InputError: If a log does not suit the mode, a column is constant, or there
            are too few rows.
    """
    settings, tell = (settings or CalibrationSettings(), progress or (lambda stage, share: None))
    notes = (_CUT,) if len(runs) == 1 else ()
    runs = cut_single_run(runs)
    tell("nominal model", 0.0)
    thin, thinned = choose_thinning_factor(runs)
    nominal, declared = None, tuple(robot.declared)
    if settings.paper:
        rows = build_paper_rows(runs, settings.joints, thin)
        thinned += (_TWIN,) if settings.declared is not None else ()

        def compute_residuals(left_out: frozenset[int]) -> Array:
            return rows.Y

    else:
        prepared = prepare_runs(robot, runs, settings.declared)
        nominal, declared = identify_without_blocks(prepared), prepared.nominal.names

        def build_rows(model: Model) -> CalibrationRows:
            tracks = prepared.logs.tracks
            return build_measured_rows(runs, tracks, model, settings.joints, thin)

        rows = build_rows(nominal)

        @cache
        def compute_residuals(left_out: frozenset[int]) -> Array:
            if not left_out:
                return rows.Y
            return build_rows(identify_without_blocks(prepared, left_out)).Y

    schemes, more = build_validation_schemes(rows, np.random.default_rng(0))
    names = (*rows.names, *(f"tau{j}" for j in rows.joints))
    tables = choose_table_levels(rows.X, rows.tau - rows.Y, rows.velocity_columns, names)
    scores, chosen, a_opt, unseen = _table(schemes, rows, compute_residuals, tables, settings, tell)
    training = build_training_rows(rows, rows.Y, tables).with_fitted_standstill()
    fitted = fit_nominal_pls(training.X, training.Y, settings.form)
    best = fitted.components if settings.exact_components else a_opt
    components = min(best, fitted.components)
    calibration = Calibration(
        robot.name,
        rows,
        scores,
        chosen,
        len(rows.labels) >= FEW,
        fit_all_corrections(training, tables).lookup(chosen),
        replace(fitted.lookup(components), names=rows.names),
        components,
        nominal,
        declared,
        unseen=unseen,
        notes=(*notes, *more, *thinned),
    )
    if not settings.with_figures:
        return calibration
    tell("principal components", 0.85)
    blocks = analyze_principal_components(rows, runs, np.random.default_rng(0))
    sweep = None
    if len(rows.names) <= WIDE:
        tell("levels", 0.9)
        swept = [s for s in schemes if s.name in (RUN, RANDOM)]
        sweep = sweep_level_counts(rows, swept, tables, settings.form.components)
    tell("levels", 1.0)
    return replace(calibration, blocks=blocks, sweep=sweep)


def _table(
    schemes: Sequence[ValidationScheme],
    rows: CalibrationRows,
    compute_residuals: Callable[[frozenset[int]], Array],
    tables: TableColumns,
    settings: CalibrationSettings,
    tell: Progress,
) -> tuple[tuple[ModelScore, ...], tuple[CorrectionOption, ...], int, UnseenRun | None]:
    """Return the cells, and by the first scheme each joint's option and A_opt.

    The last value is a run that no model was fitted to, None if no run was left out.
    """
    shown = find_median_error_run(rows)
    options = list_correction_options(len(rows.names))
    first = BLOCK if len(rows.labels) < FEW else RUN

    def tried(scheme: ValidationScheme, options: Sequence[CorrectionOption]) -> SchemeErrors:
        tell(SCHEMES[scheme.name], 0.1 + 0.7 * schemes.index(scheme) / len(schemes))
        paper = scheme.unseen or len(rows.names) <= WIDE
        form, fold = settings.form if paper else None, scheme.name == RUN
        args = (scheme, rows, compute_residuals, tables, options, form)
        return cross_validate_corrections(*args, shown if fold else None)

    lead = tried(next(s for s in schemes if s.name == first), options)
    chosen = choose_joint_options(lead.seconds, lead.options)
    # Rows of every run are fitted where rows are left out, so the choice is made.
    settled = [o for o in options if o.ridge is None or o in chosen]
    scores: list[ModelScore] = []
    unseen, components = None, 0
    for scheme in schemes:
        if scheme.name == first:
            trial = lead
        elif settings.schemes is None or scheme.name in settings.schemes:
            trial = tried(scheme, options if scheme.unseen else settled)
        else:
            continue
        fold_choices = choose_fold_options(trial, lead, rows)
        cells = score_models(trial, fold_choices)
        if trial is lead:
            components = find_model_score(cells, first, PAPER_FORM).components
        if settings.schemes is None or scheme.name in settings.schemes:
            scores += cells
        if scheme.name == RUN:
            residual = compute_residuals(scheme.left_out[shown])
            unseen = build_unseen_run(rows, trial, shown, residual, fold_choices[shown])
    return tuple(scores), chosen, components, unseen


def build_corrected_model(calibration: Calibration) -> CorrectedModel | None:
    """Return model and tables as one model, which predicts a torque.

    It is the model identified from all logs plus the tables; None where they correct a
    simulated twin, or torque as a sensor reports it.
    """
    model, lookup = calibration.nominal, calibration.lookup
    if calibration.rows.mode == PAPER or model is None:
        return None
    if any(EffectTrait.REPORT in term.effect.traits for term in model.terms):
        return None
    return add_correction_tables(model, lookup, calibration.rows.joints)


def add_correction_tables(model: Model, lookup: Lookup, joints: Sequence[int]) -> CorrectedModel:
    """Add the tables of a calibration to a model; its joints are from 1."""
    columns, tables = [], []
    for name in lookup.names:  # a column of the state: q1, qd1, qdd1, or tau1
        on, number, _ = re.split(r"(\d+)", name)
        on = "tau_model" if on == "tau" else on
        columns.append(TableVariable(on, (int(number) - 1,), ""))
    for m, joint in enumerate(joints):
        part = _of_joint(lookup, m)
        empty = not (part.tables or part.offset.any() or part.slope.any())
        kind = NONE if empty else MAIN
        tables.append(JointCorrection(joint - 1, tuple(columns), part, kind, NEAREST))
    return CorrectedModel(model, tuple(tables))


def _of_joint(lookup: Lookup, m: int) -> Lookup:
    """Return the tables of one response, without those that are zero for it."""
    tables = [t for t in lookup.tables if t.values[..., m].any()]
    used = sorted({axis for t in tables for axis in t.axes})
    place = {axis: k for k, axis in enumerate(used)}
    cut = (LookupTable(tuple(place[a] for a in t.axes), t.values[..., [m]]) for t in tables)
    return replace(
        lookup,
        joints=(lookup.joints[m],),
        axes=tuple(lookup.axes[axis] for axis in used),
        tables=tuple(cut),
        offset=np.array(lookup.offset[[m]]),
        slope=np.array(lookup.slope[:, [m]]),
    )
