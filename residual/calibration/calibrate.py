"""The paper's chapter on a set of runs: every model under every scheme.

Which states the robot was in, what its model leaves there, and how well that is
predicted: on rows of a motion that was seen, and on motions that were not. (Sections
2.4 to 2.6 of the paper; docs/calibration.md.)

A correction that is judged on unseen runs starts from a model that has not seen them
either: declared effects and rigid body under a prior whose width the logs choose.
"""

import re
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from residual.calibration.choice import (
    MAIN,
    NONE,
    Option,
    candidates,
    choose,
    fit_forms,
)
from residual.calibration.effects import Tables, make_tables
from residual.calibration.nominal_pls import NominalForm, fit_nominal_pls
from residual.calibration.rows import (
    FEW,
    PAPER,
    Blocks,
    Rows,
    Run,
    chosen_rows,
    cut_blocks,
    cut_single,
    measured_rows,
    paper_rows,
    row_times,
    thinning,
    torque_at,
)
from residual.calibration.scores import (
    BLOCK,
    PAPER_FORM,
    RANDOM,
    RUN,
    SCHEMES,
    WIDE,
    Scheme,
    Score,
    Trial,
    choices,
    find,
    make_schemes,
    scores_of,
    training_of,
    try_forms,
)
from residual.calibration.views import (
    Components,
    Sweep,
    Unseen,
    components_of,
    middle_run,
    sweep_levels,
    unseen_run,
)
from residual.effects.base import Trait
from residual.evidence.design import Design
from residual.evidence.fit import as_model, fit, fit_nominal
from residual.evidence.priors import priors
from residual.model.lookup import (
    NEAREST,
    Column,
    CorrectedModel,
    Lookup,
    LookupTable,
)
from residual.model.lookup import Tables as JointTables
from residual.model.model import Model
from residual.model.nominal import (
    Logs,
    Nominal,
    declared_names,
    prepare_logs,
    start_nominal,
    with_standstill,
)
from residual.recording import Array
from residual.robot.robot import Robot
from residual.signals.splitting import spread
from residual.signals.track import Filters

Progress = Callable[[str, float], None]
# On random rows the error still falls at 30 components; the paper does not say.
PAPER_SETTING = NominalForm(components=30)
_TWIN = "--declared says nothing with --paper: the twin has what its robot declares"
_CUT = "one log only: it was cut into parts, so unseen parts are of the same run"


@dataclass(frozen=True, eq=False, slots=True)
class PreparedRuns:
    """All logs, ready for as many identifications as there are folds.

    Attributes:
        logs: Signals and the range of motion.
        runs: The logs behind them.
        nominal: Where every identification starts.
        blocks: Blocks of the logs, which identifications may leave out.
        places: Place of each log's rows in them.
        design: Columns of the nominal model; its folds are those places.
    """

    logs: Logs
    runs: tuple[Run, ...]
    nominal: Nominal
    blocks: Blocks
    places: tuple[Array, ...]
    design: Design

    def residuals(self, model: Model) -> tuple[Array, ...]:
        """Measured minus model torque on each log's track [N m]. Shapes (n, dof)."""
        out = []
        for run, track in zip(self.runs, self.logs.tracks, strict=True):
            out.append(torque_at(run.log, track) - model.torque_on(track))
        return tuple(out)


def prepare_runs(
    robot: Robot, runs: Sequence[Run], declared: Sequence[str] | None
) -> PreparedRuns:
    """Filter all logs once; declared effects are the robot's own list for None."""
    logs = prepare_logs(robot, [run.log for run in runs], None, Filters(), split=False)
    nominal = start_nominal(logs, declared_names(robot, declared))
    blocks = cut_blocks([track.t[chosen_rows(track)] for track in logs.tracks])
    numbered = enumerate(map(row_times, logs.tracks))
    places = tuple(blocks.places(run, t) for run, t in numbered)
    design = Design(logs.tracks, nominal.model, labels=list(places))
    return PreparedRuns(logs, tuple(runs), nominal, blocks, places, design)


def identified_without(prepared: PreparedRuns, left_out: Collection[int] = ()) -> Model:
    """Identify the model from all blocks of the runs but some, by number."""
    design, nominal = prepared.design, prepared.nominal
    if left_out:
        folds = prepared.blocks.kept(left_out)  # a last edge may have no rows
        design = design.part(folds[folds < design.folds], alone=True)
    wide = priors(design, nominal)
    first = fit_nominal(design, wide[-1])
    fits = [fit(design, p, (), first.counted, None, rounds=4) for p in wide]
    best = as_model(nominal, max(fits, key=lambda f: f.score))
    tracks = []  # what is left of each log
    for track, places in zip(prepared.logs.tracks, prepared.places, strict=True):
        kept = prepared.blocks.mask(places, left_out)
        if kept.all():
            tracks.append(track)
        elif kept.any():
            inner, moving = track.inner & kept, track.moving & kept[:, None]
            tracks.append(replace(track, inner=inner, moving=moving))
    shown = spread([track.seconds for track in tracks])
    return with_standstill(best, [tracks[i] for i in shown])


@dataclass(frozen=True, slots=True)
class Settings:
    """How a calibration is done.

    Attributes:
        paper: The paper's regressors and twin error, in place of measured motion.
        declared: Effects that the nominal model has; None for the robot's own list.
        form: Levels of the paper's form, and components: at most so many are tried.
        exact: Whether the exported tables of the paper's form have just so many.
        joints: Joints of X and Y, from 1; None for all, or the paper's.
        views: Whether to compute what only figures need.
        schemes: Schemes to report; None for all that the rows allow.
    """

    paper: bool = False
    declared: tuple[str, ...] | None = None
    form: NominalForm = PAPER_SETTING
    exact: bool = False
    joints: tuple[int, ...] | None = None
    views: bool = True
    schemes: tuple[str, ...] | None = None


@dataclass(frozen=True, eq=False, slots=True)
class Calibration:
    """Look-up tables, and what each form is worth.

    Attributes:
        robot: Name of the robot.
        rows: The rows.
        scores: The table.
        chosen: What the default form takes for each joint.
        proven: Whether there were enough runs to choose by.
        default: The default form on all rows, as tables.
        paper: The paper's form on all rows, as tables.
        components: Its number of components.
        nominal: Nominal model identified from all runs; None in paper mode.
        declared: Effects that the nominal model has.
        blocks, sweep, unseen: For the figures; None or empty where they are not there.
        notes: What to know about it, a line each.
    """

    robot: str
    rows: Rows
    scores: tuple[Score, ...]
    chosen: tuple[Option, ...]
    proven: bool
    default: Lookup
    paper: Lookup
    components: int
    nominal: Model | None
    declared: tuple[str, ...]
    blocks: tuple[Components, ...] = ()
    sweep: Sweep | None = None
    unseen: Unseen | None = None
    notes: tuple[str, ...] = field(default=())

    @property
    def lookup(self) -> Lookup:
        """The tables of this mode: the paper's form, or ours."""
        return self.paper if self.rows.mode == PAPER else self.default


class Source:
    """Rows, and what nominal models leave on them; each is identified once."""

    def __init__(self, robot: Robot, runs: Sequence[Run], settings: Settings) -> None:
        self._prepared: PreparedRuns | None = None
        self._known: dict[frozenset[int], Array] = {}
        self.nominal: Model | None = None
        self.declared: tuple[str, ...] = tuple(robot.declared)
        self._thin, self.notes = thinning(runs)
        if settings.paper:
            self.rows = paper_rows(runs, settings.joints, self._thin)
            self.notes += (_TWIN,) if settings.declared is not None else ()
            return
        self._prepared = prepare_runs(robot, runs, settings.declared)
        self.declared = self._prepared.nominal.names
        self.nominal = identified_without(self._prepared)
        self._joints = settings.joints
        self.rows = self._rows(self.nominal)
        self._known[frozenset()] = self.rows.Y

    def residual(self, left_out: Collection[int]) -> Array:
        """What a nominal model leaves that has not seen some blocks. Shape (n, j)."""
        if self._prepared is None:
            return self.rows.Y
        key = frozenset(left_out)
        if key not in self._known:
            self._known[key] = self._rows(identified_without(self._prepared, key)).Y
        return self._known[key]

    def _rows(self, model: Model) -> Rows:
        ready = self._prepared
        parts = ready.runs, ready.logs.tracks, ready.residuals(model)
        return measured_rows(*parts, self._joints, self._thin)


def calibrate(
    robot: Robot,
    runs: Sequence[Run],
    settings: Settings | None = None,
    progress: Progress | None = None,
) -> Calibration:
    """Fit and validate every model under every scheme.

    Args:
        runs: Its logs; a single one is cut into parts. Of more than 15 min all identify
            the model, and tables take every second row, or third, or fewer.

    Raises:
        InputError: If a log does not suit the mode, a column is constant, or there
            are too few rows.
    """
    settings, tell = settings or Settings(), progress or (lambda stage, share: None)
    notes = (_CUT,) if len(runs) == 1 else ()
    runs = cut_single(runs)
    tell("nominal model", 0.0)
    source = Source(robot, runs, settings)
    rows = source.rows
    schemes, more = make_schemes(rows, np.random.default_rng(0))
    names = (*rows.names, *(f"tau{j}" for j in rows.joints))
    tables = make_tables(rows.X, rows.tau - rows.Y, rows.velocities, names)
    scores, chosen, a_opt, unseen = _table(schemes, source, tables, settings, tell)
    training = training_of(rows, rows.Y, tables).with_fitted_standstill()
    fitted = fit_nominal_pls(training.X, training.Y, settings.form, fewer=True)
    best = fitted.components if settings.exact else a_opt
    components = min(best, fitted.components)
    calibration = Calibration(
        robot.name,
        rows,
        scores,
        chosen,
        len(rows.labels) >= FEW,
        fit_forms(training, tables).lookup(chosen),
        replace(fitted.lookup(components), names=rows.names),
        components,
        source.nominal,
        source.declared,
        unseen=unseen,
        notes=(*notes, *more, *source.notes),
    )
    if not settings.views:
        return calibration
    tell("principal components", 0.85)
    blocks = components_of(rows, runs, np.random.default_rng(0))
    sweep = None
    if len(rows.names) <= WIDE:
        tell("levels", 0.9)
        swept = [s for s in schemes if s.name in (RUN, RANDOM)]
        sweep = sweep_levels(rows, swept, tables, settings.form.components)
    tell("levels", 1.0)
    return replace(calibration, blocks=blocks, sweep=sweep)


def _table(
    schemes: Sequence[Scheme],
    source: Source,
    tables: Tables,
    settings: Settings,
    tell: Progress,
) -> tuple[tuple[Score, ...], tuple[Option, ...], int, Unseen | None]:
    """Return the cells, and by the first scheme each joint's option and A_opt.

    Last comes a run that no model has seen, None where no run was left out.
    """
    rows, shown = source.rows, middle_run(source.rows)
    options = candidates(len(rows.names))
    first = BLOCK if len(rows.labels) < FEW else RUN

    def tried(scheme: Scheme, options: Sequence[Option]) -> Trial:
        tell(SCHEMES[scheme.name], 0.1 + 0.7 * schemes.index(scheme) / len(schemes))
        paper = scheme.unseen or len(rows.names) <= WIDE
        form, fold = settings.form if paper else None, scheme.name == RUN
        args = (scheme, rows, source.residual, tables, options, form)
        return try_forms(*args, shown if fold else None)

    lead = tried(next(s for s in schemes if s.name == first), options)
    chosen = choose(lead.seconds, lead.options)
    # Rows of every run are fitted where rows are left out, so the choice is made.
    settled = [o for o in options if o.ridge is None or o in chosen]
    scores: list[Score] = []
    unseen, components = None, 0
    for scheme in schemes:
        if scheme.name == first:
            trial = lead
        elif settings.schemes is None or scheme.name in settings.schemes:
            trial = tried(scheme, options if scheme.unseen else settled)
        else:
            continue
        fold_choices = choices(trial, lead, rows)
        cells = scores_of(trial, fold_choices)
        if trial is lead:
            components = find(cells, first, PAPER_FORM).components
        if settings.schemes is None or scheme.name in settings.schemes:
            scores += cells
        if scheme.name == RUN:
            residual = source.residual(scheme.left_out[shown])
            unseen = unseen_run(rows, trial, shown, residual, fold_choices[shown])
    return tuple(scores), chosen, components, unseen


def corrected_model(calibration: Calibration) -> CorrectedModel | None:
    """Return model and tables as one model, which predicts a torque.

    The model that was identified from all logs with the tables on top; None where they
    correct a simulated twin, or torque as a sensor reports it.
    """
    model, lookup = calibration.nominal, calibration.lookup
    if calibration.rows.mode == PAPER or model is None:
        return None
    if any(Trait.REPORT in term.effect.traits for term in model.terms):
        return None
    return with_tables(model, lookup, calibration.rows.joints)


def with_tables(model: Model, lookup: Lookup, joints: Sequence[int]) -> CorrectedModel:
    """Put the tables of a calibration on a model; its joints are from 1."""
    columns, tables = [], []
    for name in lookup.names:  # a column of the state: q1, qd1, qdd1, or tau1
        on, number, _ = re.split(r"(\d+)", name)
        on = "tau_model" if on == "tau" else on
        columns.append(Column(on, (int(number) - 1,), ""))
    for m, joint in enumerate(joints):
        part = _of_joint(lookup, m)
        empty = not (part.tables or part.offset.any() or part.slope.any())
        kind = NONE if empty else MAIN
        tables.append(JointTables(joint - 1, tuple(columns), part, kind, NEAREST))
    return CorrectedModel(model, tuple(tables))


def _of_joint(lookup: Lookup, m: int) -> Lookup:
    """The same for one response alone; tables that are zero for it are left out."""
    tables = [t for t in lookup.tables if t.values[..., m].any()]
    used = sorted({axis for t in tables for axis in t.axes})
    place = {axis: k for k, axis in enumerate(used)}
    cut = (
        LookupTable(tuple(place[a] for a in t.axes), t.values[..., [m]]) for t in tables
    )
    return replace(
        lookup,
        joints=(lookup.joints[m],),
        axes=tuple(lookup.axes[axis] for axis in used),
        tables=tuple(cut),
        offset=np.array(lookup.offset[[m]]),
        slope=np.array(lookup.slope[:, [m]]),
    )
