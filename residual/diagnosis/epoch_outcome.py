"""The outcome of two epochs: named changes, unnamed changes, and models."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import stdtr

from residual.diagnosis.adequacy import Adequacy
from residual.diagnosis.epochs import CommonModelFit, Epochs, fit_common_model
from residual.diagnosis.outcome import Outcome, leave_out_impossible_bodies
from residual.diagnosis.search import Members, SearchRun
from residual.diagnosis.select import Member, Selection, Weighted, judge_members
from residual.effects.base import EffectTrait
from residual.evidence.design import Design
from residual.evidence.fit import (
    Fit,
    PossibleModel,
    SeparateTerm,
    build_fitted_model,
    fit_possible_bodies,
)
from residual.evidence.priors import SCALES
from residual.evidence.thresholds import THRESHOLDS
from residual.model.compare import HeldOutLog, compute_moving_error
from residual.model.model import Model, Term
from residual.model.nominal import (
    FitLogs,
    NominalModel,
    choose_standstill_behaviour,
    prepare_fit_logs,
    start_model,
)
from residual.recording import Array, Recording
from residual.robot.robot import Robot
from residual.signals.splitting import find_session_start, pick_spread_pieces
from residual.signals.track import FilterSettings

# The models of two epochs: the arm before, after, and before with the change added.
#
# The nominal model is the first epoch's fit with the small effects of any arm, the
# identified one the same for the second epoch, the augmented one the fit of both with the
# changes.


@dataclass(frozen=True, eq=False, slots=True)
class EpochFit:
    """One epoch's fit."""

    logs: FitLogs  # its logs
    model: Model  # the fitted model
    joint: CommonModelFit  # its fit


def fit_epoch(
    robot: Robot, recordings: Sequence[Recording], nominal: NominalModel, like: Model | None = None
) -> EpochFit:
    """Fit the logs of one epoch.

    Args:
        like: The fit of an earlier epoch, as the start: parameters that these logs do
            not determine, and the standstill, stay unchanged.
    """
    clock, pieces = find_session_start(recordings), pick_spread_pieces(recordings)
    logs = prepare_fit_logs(robot, pieces, clock, FilterSettings())
    start = start_model(logs, nominal.model if like is None else like)
    nominal = replace(nominal, model=start)
    joint = fit_common_model(logs, nominal, SCALES)
    rough = build_fitted_model(nominal, joint.fitted)
    rough = fit_possible_bodies(joint.design, joint.fitted, rough).model
    if like is None:
        # Dissipating effects determine the standstill; others are omitted to save time.
        kept = [t for t in rough.terms if _brakes(t) or t.effect.carries]
        still = choose_standstill_behaviour(replace(rough, terms=tuple(kept)), logs.tracks)
        rough = replace(rough, standstill=still.standstill)
    return EpochFit(logs, _with_tables(rough, nominal), joint)


def _brakes(term: Term) -> bool:
    return EffectTrait.FRICTION in term.effect.traits


def _with_tables(rough: Model, nominal: NominalModel) -> Model:
    """Move the small effects of any arm into the model's tables, without names."""
    start = nominal.model
    count = len(start.terms)
    terms = tuple(term.as_nominal() for term in rough.terms[:count])
    tables = _merge_terms((*start.tables, *rough.terms[count:]))
    return replace(rough, terms=terms, tables=tables)


def _merge_terms(terms: Sequence[Term]) -> tuple[Term, ...]:
    """Merge terms of the same effect, joints and shape."""
    out: dict[tuple, Term] = {}
    for term in terms:
        key = term.effect.name, term.joints, term.shape
        known = out.get(key)
        out[key] = replace(known, theta=known.theta + term.theta) if known else term
    return tuple(out.values())


@dataclass(frozen=True, eq=False, slots=True, kw_only=True)
class EpochOutcome(Outcome):
    """The outcome of two epochs."""

    epochs: Epochs
    like: Model  # the first epoch's, whose standstill all models share

    def error(self, fitted: Fit, held_out: Sequence[HeldOutLog]) -> Array:
        """Squared error of the augmented model on moving rows by second."""
        return compute_moving_error(self._augment(fitted, False).model, held_out)

    def assess(self, fitted: Fit) -> Adequacy:
        """The residual of the second epoch beyond the first."""
        return _assess_second_epoch(self.epochs, fitted, self.selection.curves)

    def possible(self) -> PossibleModel:
        """The augmented model."""
        return self.model(self.fit)

    def fit_at_nominal(self, member: Member) -> Fit | None:
        """None: a change has no given value."""
        return None

    def model(self, fitted: Fit, like: Model | None = None) -> PossibleModel:
        """The arm of both epochs, with the changes, including warmth of all joints."""
        return self._augment(fitted, True)

    def _augment(self, fitted: Fit, corrects: bool) -> PossibleModel:
        """Fit the unchanged part to both epochs, the second less its changes.

        Either epoch alone determines it less well.

        Args:
            corrects: Whether impossible bodies are replaced by the nearest possible.
        """
        groups = fitted.members
        changed = [Term(g.effect, g.joints, g.shape, fitted.of(g)) for g in groups]
        design, common, torques = self.epochs.fit_without(changed)
        rough = build_fitted_model(self.nominal, common)
        full = replace(rough, terms=(*rough.terms, *changed))
        possible = PossibleModel(full, None)
        if corrects:
            possible = self._find_possible(design, common, full, fitted)
        count, terms = len(rough.terms), possible.model.terms
        model = _with_tables(replace(possible.model, terms=terms[:count]), self.nominal)
        model = replace(model, standstill=self.like.standstill)
        if self.drift:
            factor = 1.0 + self._friction_factors(fitted, common, torques)
            model = replace(
                model,
                terms=_scale_friction(model.terms, factor),
                tables=_scale_friction(model.tables, factor),
            )
        return replace(possible, model=replace(model, terms=(*model.terms, *terms[count:])))

    def _find_possible(
        self, design: Design, common: Fit, full: Model, fitted: Fit
    ) -> PossibleModel:
        covariance = fitted.covariance()
        apart, groups = [], design.add([g.placed for g in fitted.members])
        for member, group in zip(fitted.members, groups, strict=True):
            slots, columns = fitted.slots(member), []
            for j, rows in enumerate(self.epochs.design.epochs):
                place, have = design.present(j, group.ids)
                columns.append(np.zeros((len(rows.second), len(slots))))
                columns[j][:, have] = rows.second[:, None] * design.columns(j, place)
            apart.append(SeparateTerm(covariance[np.ix_(slots, slots)], tuple(columns)))
        possible = fit_possible_bodies(design, common, full, apart)
        if possible.correction is None:
            return possible
        # A drive may misreport a weight, which contradicts no body.
        large = max(possible.correction.price) > THRESHOLDS.gain_share
        return replace(possible, contradicted=possible.contradicted and large)

    @property
    def drift(self) -> float:
        """Friction of all joints over the first epoch's, less one; 0 if by chance.

        Accounts for the spread between joints.
        """
        found, sure = self.epochs.drift, THRESHOLDS.drift_deviations
        least = max(sure * found.deviation, THRESHOLDS.friction_spread)
        return found.warmth if abs(found.warmth or 0.0) > least else 0.0

    def _friction_factors(self, fitted: Fit, common: Fit, torques: Sequence[Array]) -> Array:
        """Friction of the second epoch over the joint fit's, less one. Shape (dof,).

        The joint fit lies between the epochs, by their lengths; each joint deviates from
        the common factor as far as its rows show.
        """
        epochs, raw = self.epochs, self.epochs.common.design
        places = epochs.design.epochs
        share = float(np.concatenate([own.second for own in places]).mean())
        drift = self.drift * (1 - share)
        out, weight = np.full(raw.dof, drift), fitted.weight
        for j, own in enumerate(places):
            if not own.compared:
                continue
            left = raw.residual(j, common.ids, common.theta)[own.second]
            left, f = left - torques[j][own.second], epochs.friction[j][own.second]
            usual = epochs.drift.spread[j] ** -2
            out[j] = (usual * drift + weight[j] * (f @ left)) / (usual + weight[j] * (f @ f))
        return out


def _scale_friction(terms: Sequence[Term], factor: Array) -> tuple[Term, ...]:
    return tuple(
        replace(t, theta=factor[t.joints[0]] * t.theta) if _brakes(t) else t for t in terms
    )


def conclude_epochs(epochs: Epochs, run: SearchRun, like: Model) -> EpochOutcome:
    """Return the certain changes, with the data on the others."""
    search = epochs.search
    members = judge_members(search, run, Weighted((run,), (1.0,)), set(), {})
    score = run.score
    fitted = score.fit([m.group for m in members], run.fit)
    selection = Selection(search, fitted, members, run.curves, score.prior.scale, score.prior)
    named = tuple(m for m in members if m.probability >= THRESHOLDS.sure_probability)
    if len(named) < len(members):
        fitted = score.fit([m.group for m in named], fitted)
    outcome = EpochOutcome(
        logs=epochs.logs,
        nominal=epochs.nominal,
        selection=selection,
        plain=score.fit((), fitted),
        fit=fitted,
        named=named,
        adequacy=_assess_second_epoch(epochs, fitted, run.curves),
        epochs=epochs,
        like=like,
    )
    return leave_out_impossible_bodies(outcome)


# Unnamed changes: a larger residual than in the first epoch, or a curve.
#
# Every block is predicted by a fit without it, in both epochs. If the errors of blocks of
# the second epoch exceed those of the first, and the differences between its logs, there
# is a change that no known effect explains.


def _assess_second_epoch(epochs: Epochs, fitted: Fit, curves: Members) -> Adequacy:
    """Excess residual of each joint in the second epoch over the first."""
    design = epochs.design
    left = epochs.search.score.left_out(fitted).errors
    share, floor = np.zeros((2, design.dof))
    grew = {j for g in curves for j in g.joints}
    for j, own in enumerate(design.epochs):
        if not own.compared:
            continue
        count = np.bincount(own.block, minlength=design.folds)
        blocks = np.flatnonzero(count >= THRESHOLDS.min_block_rows)
        power = left[blocks, j] / count[blocks]
        at = np.searchsorted(own.block, blocks)
        second, log = own.second[at], own.log[at]
        before, after = power[~second], power[second]
        if min(len(before), len(after)) < 4:
            continue
        floor[j] = np.sqrt(before.mean()) / design.rms[j]
        more = max(after.mean() - before.mean(), 0.0)
        share[j] = np.sqrt(more) / design.rms[j]
        chance = _excess_chance(before, after, log[~second], log[second])
        if share[j] > THRESHOLDS.changed_share and chance < THRESHOLDS.noise_chance:
            grew.add(j)
    flagged = tuple(sorted(grew))
    return Adequacy(share, share, floor, (None,) * design.dof, flagged, flagged)


def _excess_chance(before: Array, after: Array, logs: Array, fresh: Array) -> float:
    """Probability of such an excess of the second epoch's errors by chance.

    Uses logarithms, which are nearly normal; differences between logs widen the limit.
    """
    a, b = np.log(before + 1e-300), np.log(after + 1e-300)
    free = len(a) + len(b) - 2
    within = (a.var() * len(a) + b.var() * len(b)) / free
    means = np.array([a[logs == i].mean() for i in np.unique(logs)])
    # With few logs the spread is shrunk towards a typical one.
    spread = float(((means - means.mean()) ** 2).sum())
    usual, known = THRESHOLDS.usual_logs, len(means) - 1
    between = (spread + usual * THRESHOLDS.usual_log_spread**2) / (known + usual)
    sd = np.sqrt(
        within * (1 / len(a) + 1 / len(b)) + between * (1 / len(means) + 1 / len(np.unique(fresh)))
    )
    # Of Student's t, the share above.
    return float(stdtr(free, -(b.mean() - a.mean()) / max(sd, 1e-12)))
