"""The paper's chapter on a set of runs: every model under every scheme.

Which states the robot was in, what its model leaves there, and how well that is
predicted: on rows of a motion that was seen, and on motions that were not. (Sections
2.4 to 2.6 of the paper; docs/calibration.md.)
"""

import re
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from residual.calibration.choice import Training, chosen_model, lookup_of
from residual.calibration.methods import (
    EFFECTS,
    Choices,
    Forms,
    fit_chosen,
    levels_of,
    methods,
)
from residual.calibration.methods import NONE as NOTHING
from residual.calibration.nominal import (
    Prepared,
    identified_without,
    prepare_runs,
)
from residual.calibration.rows import (
    FEW,
    PAPER,
    Rows,
    Run,
    cut_single,
    measured_rows,
    paper_rows,
    shorten,
    thinning,
)
from residual.calibration.scores import (
    RUN,
    UNSEEN,
    Scheme,
    Score,
    make_schemes,
    score,
)
from residual.calibration.views import (
    SWEEP,
    Components,
    Oddities,
    Plane,
    Sweep,
    Terms,
    Unseen,
    components_of,
    oddities_of,
    plane_of,
    sweep_levels,
    terms_of,
    unseen_run,
)
from residual.model.corrected import NEAREST, Column, Corrected, Tables
from residual.model.model import Model, Term
from residual.recording import Array
from residual.robot.robot import Robot
from residual.tables.form import MAIN, NONE, EffectForm, Option
from residual.tables.lookup import Axis, Lookup, Table
from residual.tables.nominal_choice import ChosenLevels
from residual.tables.nominal_pls import NominalForm, fit_nominal_pls, nominal_lookup

Progress = Callable[[str, float], None]
# On random rows the error still falls at 30 components; the paper does not say.
PAPER_SETTING = NominalForm(components=30)
_SWEEP_COMPONENTS = 15
_TWIN = "--declared says nothing with --paper: the twin has what its robot declares"
_CUT = "one log only: it was cut into parts, so unseen parts are of the same run"
MOST_CHOSEN = 12  # variables: of six joints there are four times the pairs of three


@dataclass(frozen=True, slots=True)
class Settings:
    """How a calibration is done.

    Attributes:
        paper: The paper's regressors and twin error, in place of measured motion.
        declared: Effects that the nominal model has; None for the robot's own list.
        form: Levels and components of the paper's form.
        given: Whether levels and components are to be exactly so, and none is chosen.
        joints: Joints of X and Y, from 1; None for all, or the paper's.
        pairs: Whether the default form may take all pair tables.
        views: Whether to compute what only figures need.
        levels: Numbers of levels of the sweep.
        schemes: Schemes to judge under; None for all that the rows allow.
        seed: Of random blocks and surrogates.
    """

    paper: bool = False
    declared: tuple[str, ...] | None = None
    form: NominalForm = PAPER_SETTING
    given: bool = False
    joints: tuple[int, ...] | None = None
    pairs: bool = True
    views: bool = True
    levels: tuple[int, ...] = SWEEP
    schemes: tuple[str, ...] | None = None
    seed: int = 0


@dataclass(frozen=True, eq=False, slots=True)
class Calibration:
    """What was found.

    Attributes:
        robot: Name of the robot.
        rows: The rows.
        schemes: The schemes that these rows allow.
        scores: The table.
        chosen: What the default form takes for each joint.
        levels: Levels and components of the paper's form that were chosen; None where
            they were given.
        proven: Whether there were enough runs to choose by.
        default: The default form on all rows, as tables.
        paper: The paper's form on all rows, as tables, with these levels.
        nominal: Nominal model identified from all runs; None in paper mode.
        declared: Effects that the nominal model has.
        components, sweep, terms, oddities: For the figures; None where not wanted.
        unseen, plane: The same: a run that no model saw, scores and loadings of PLSR.
        notes: What to know about it, a line each.
    """

    robot: str
    rows: Rows
    schemes: tuple[Scheme, ...]
    scores: tuple[Score, ...]
    chosen: tuple[Option, ...]
    levels: ChosenLevels | None
    proven: bool
    default: Lookup
    paper: Lookup
    nominal: Model | None
    declared: tuple[str, ...]
    components: tuple[Components, ...] = ()
    sweep: Sweep | None = None
    terms: Terms | None = None
    oddities: Oddities | None = None
    unseen: Unseen | None = None
    plane: Plane | None = None
    notes: tuple[str, ...] = field(default=())

    @property
    def lookup(self) -> Lookup:
        """The tables of this mode: the paper's form, or ours."""
        return self.paper if self.rows.mode == PAPER else self.default


class Source:
    """Rows, and what nominal models leave on them; each is identified once."""

    def __init__(
        self,
        robot: Robot,
        runs: Sequence[Run],
        settings: Settings,
        named: Sequence[Term],
    ) -> None:
        self._prepared: Prepared | None = None
        self._known: dict[tuple, Array] = {}
        self.nominal: Model | None = None
        self.declared: tuple[str, ...] = tuple(robot.declared)
        self.named: tuple[Term, ...] = ()
        if settings.paper:
            runs, self.notes = shorten(runs)
            self.rows = paper_rows(runs, settings.joints)
            self.notes += (_TWIN,) if settings.declared is not None else ()
            return
        self._prepared = prepare_runs(robot, runs, settings.declared)
        self.declared = self._prepared.names
        self.nominal = identified_without(self._prepared)
        self._thin, self.notes = thinning(runs)
        self._joints = settings.joints
        self.rows = self._rows(self.nominal)
        self._known[frozenset(), False] = self.rows.Y
        self.named = tuple(named)

    def plain(self, left_out: Collection[int]) -> Array:
        """What the nominal model leaves. Shape (n, j)."""
        return self._left(left_out, ())

    def with_effects(self, left_out: Collection[int]) -> Array:
        """What the model with named effects leaves. Shape (n, j)."""
        return self._left(left_out, self.named)

    def _left(self, left_out: Collection[int], named: tuple[Term, ...]) -> Array:
        if self._prepared is None:
            return self.rows.Y
        key = (frozenset(left_out), bool(named))
        if key not in self._known:
            model = identified_without(self._prepared, left_out, named)
            self._known[key] = self._rows(model).Y
        return self._known[key]

    def _rows(self, model: Model) -> Rows:
        ready = self._prepared
        left = ready.residuals(model)
        return measured_rows(ready.runs, ready.tracks, left, self._joints, self._thin)


def calibrate(
    robot: Robot,
    runs: Sequence[Run],
    settings: Settings | None = None,
    named: Sequence[Term] = (),
    progress: Progress | None = None,
) -> Calibration:
    """Fit and validate every model under every scheme.

    Args:
        runs: Its logs; a single one is cut into parts. Of more than 15 min all identify
            the model, and tables take every second row, or third, or fewer.
        named: What a diagnosis found, for the model with named effects.

    Raises:
        InputError: If a log does not suit the mode, a column is constant, or there
            are too few rows.
    """
    settings, tell = settings or Settings(), progress or (lambda stage, share: None)
    notes = (_CUT,) if len(runs) == 1 else ()
    runs = cut_single(runs)
    tell("nominal model", 0.0)
    source = Source(robot, runs, settings, named)
    rows = source.rows
    schemes, more = make_schemes(rows, np.random.default_rng(settings.seed))
    if settings.schemes is not None:
        schemes = tuple(s for s in schemes if s.name in settings.schemes)
    without = None if settings.paper else source.plain
    parts = (rows.X, rows.Y, rows.run, rows.tau, rows.part, rows.second, rows.moving)
    training = Training(*parts, without)
    taught = training.taught()
    forms = _forms(rows, settings)
    tell("default form", 0.05)
    default, options = chosen_model(training, forms.default)
    tell("levels", 0.08)
    chosen = Choices(options, levels_of(taught, forms) if forms.levels else None)
    if chosen.levels is None:
        fitted = fit_nominal_pls(taught.X, taught.Y, settings.form, fewer=True)
        paper = nominal_lookup(fitted)
    else:
        paper = nominal_lookup(*fit_chosen(taught, chosen.levels))
    paper = replace(paper, names=rows.names)
    made = Calibration(
        robot.name,
        rows,
        schemes,
        _table(schemes, training, source, forms, chosen, tell),
        options,
        chosen.levels,
        len(rows.labels) >= FEW,
        lookup_of(training, forms.default, default, options),
        paper,
        source.nominal,
        source.declared,
        notes=(*notes, *more, *source.notes),
    )
    if not settings.views:
        return made
    return replace(made, **_views(made, runs, training, source, forms, settings, tell))


def _forms(rows: Rows, settings: Settings) -> Forms:
    """What may be chosen from; no levels where given, or where pairs are too many."""
    first, many = len(rows.names), len(rows.names) > MOST_CHOSEN
    loads = tuple((speed, first + i) for i, speed in enumerate(rows.velocities))
    names = (*rows.names, *(f"tau{j}" for j in rows.joints))
    form = EffectForm(velocities=rows.velocities, loads=loads, names=names)
    form = form if settings.pairs else replace(form, pairs=None)
    levels = () if settings.given or many else settings.levels
    return Forms(form, settings.form, levels)


def _table(
    schemes: Sequence[Scheme],
    training: Training,
    source: Source,
    forms: Forms,
    chosen: Choices,
    tell: Progress,
) -> tuple[Score, ...]:
    nested = methods(forms)
    # Rows of every motion are fitted here anyway, so the choice is made only once.
    once = methods(forms, chosen)
    out: list[Score] = []
    for number, scheme in enumerate(schemes):
        own = nested if scheme.name in UNSEEN else once
        for place, (name, method) in enumerate(own.items()):
            done = (number + place / len(own)) / len(schemes)
            tell(f"{scheme.name}: {name}", 0.1 + 0.6 * done)
            out.append(score(scheme, name, method, training, source.plain))
        if source.named:
            # All of it is in the response: nothing is fitted.
            response = source.with_effects
            out.append(score(scheme, EFFECTS, once[NOTHING], training, response))
    return tuple(out)


def _views(
    made: Calibration,
    runs: Sequence[Run],
    training: Training,
    source: Source,
    forms: Forms,
    settings: Settings,
    tell: Progress,
) -> dict[str, object]:
    """What the paper's figures show, by field of a calibration."""
    rows = made.rows
    taught, rng = training.taught(), np.random.default_rng(settings.seed)
    tell("principal components", 0.72)
    out: dict[str, object] = {"components": components_of(rows, runs, rng)}
    tell("levels", 0.78)
    count = min(settings.form.components, _SWEEP_COMPONENTS)
    out["sweep"] = sweep_levels(taught, made.schemes, count, settings.levels)
    tell("importance", 0.9)
    out["terms"] = terms_of(taught, forms.default, made.chosen, rng)
    tell("outliers", 0.97)
    out["oddities"] = oddities_of(taught, rows, settings.form)
    tell("outliers", 1.0)
    out["plane"] = plane_of(taught, rows.names, rows.joints)
    by_run = next((scheme for scheme in made.schemes if scheme.name == RUN), None)
    if by_run is not None:
        chosen = methods(forms, Choices(made.chosen, made.levels))
        out["unseen"] = unseen_run(training, rows, by_run, chosen, source.plain)
    return out


def corrected_model(made: Calibration) -> Corrected | None:
    """Return model and tables as one model, which predicts a torque.

    The model that was identified from all logs with the tables on top; None where they
    correct a simulated twin, or torque as a sensor reports it.
    """
    model, lookup = made.nominal, made.lookup
    if made.rows.mode == PAPER or model is None:
        return None
    if any(term.effect.of_report for term in model.terms):
        return None
    return with_tables(model, lookup, made.rows.joints)


def with_tables(model: Model, lookup: Lookup, joints: Sequence[int]) -> Corrected:
    """Put the tables of a calibration on a model; its joints are from 1."""
    columns = tuple(map(_column, lookup.names))
    each = [_of_joint(lookup, m) for m in range(len(joints))]
    tables = (
        Tables(joint - 1, columns, own, _kind(own), NEAREST)
        for joint, own in zip(joints, each, strict=True)
    )
    return Corrected(model, tuple(tables))


def _kind(lookup: Lookup) -> str:
    empty = not (lookup.tables or lookup.offset.any() or lookup.slope.any())
    return NONE if empty else MAIN


def _column(name: str) -> Column:
    """A variable of the tables as a column of the state: q1, qd1, qdd1, or tau1."""
    on, number, _ = re.split(r"(\d+)", name)
    return Column("tau_model" if on == "tau" else on, (int(number) - 1,), "")


def _of_joint(lookup: Lookup, m: int) -> Lookup:
    """The same for one response alone; tables that are zero for it are left out."""
    tables = [
        Table(t.axes, t.values[..., [m]])
        for t in lookup.tables
        if t.values[..., m].any()
    ]
    used = sorted({axis for t in tables for axis in t.axes})
    place = {axis: k for k, axis in enumerate(used)}
    axes: list[Axis] = [lookup.axes[axis] for axis in used]
    moved = [Table(tuple(place[a] for a in t.axes), t.values) for t in tables]
    return Lookup(
        lookup.names,
        (lookup.joints[m],),
        tuple(axes),
        tuple(moved),
        np.array(lookup.offset[[m]]),
        np.array(lookup.slope[:, [m]]),
        lookup.low,
        lookup.high,
    )
