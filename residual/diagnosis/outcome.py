"""Diagnosis of one set of logs: what the nominal model lacks on them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.diagnosis import constants
from residual.diagnosis.gate import (
    Adequacy,
    GateResult,
    assess_adequacy,
    cross_validation_errors,
    drop_members_failing_gate,
    find_replaceable_by_curve,
    find_wrong_forms,
    judge_members_by_gate,
    torque_from_angle_noise,
)
from residual.diagnosis.search import (
    SearchTask,
    build_candidates,
    recompute_candidates,
    refine_last_shape,
)
from residual.diagnosis.select import (
    Selection,
    improve_set,
    select_set_and_prior,
    swap_for_simpler_names,
)
from residual.effects import load_effects
from residual.effects.base import EffectTrait
from residual.evidence.design import CandidateColumns, Design
from residual.evidence.fit import (
    Fit,
    NominalPrior,
    PossibleModel,
    build_fitted_model,
    fit_jointly,
    fit_possible_bodies,
    keep_physical_terms,
)
from residual.evidence.priors import (
    OF_NAMES,
    PriorSpace,
    build_first_design,
    build_relative_prior,
)
from residual.evidence.thresholds import THRESHOLDS, EvidenceThresholds
from residual.model.compare import HeldOutLog, compute_moving_error
from residual.model.model import Model
from residual.model.nominal import FitLogs, NominalModel, choose_standstill_behaviour
from residual.recording import Array

Progress = Callable[[str, float], None]


@dataclass(frozen=True, eq=False, slots=True)
class SearchOutcome:
    """What one set of logs says."""

    logs: FitLogs  # the fit logs
    nominal: NominalModel  # where it started from
    task: SearchTask  # data, chosen prior and candidates
    wide: NominalPrior  # the widest prior that the logs do not contradict
    plain: Fit  # fit of the nominal structure alone
    fit: Fit  # fit with the named effects
    tested: tuple[GateResult, ...]  # the named effects with their evidence
    withdrawn: tuple[
        GateResult, ...
    ]  # names that merely resemble what flagged joints show
    adequacy: Adequacy  # what remains
    # What was found with every constant free; None where nothing was sought.
    start: Selection | None = None
    # Joints (from 0) whose constant, that nobody declared, is in the fit.
    constants: tuple[int, ...] = ()

    def error(self, fitted: Fit, held_out: Sequence[HeldOutLog]) -> Array:
        """Squared error of a fit on moving rows by second [N^2 m^2]. (seconds, dof)."""
        return compute_moving_error(build_fitted_model(self.nominal, fitted), held_out)

    def model(self, fitted: Fit, like: Model | None = None) -> PossibleModel:
        """A fit as a model of possible bodies, with the standstill of the fit logs.

        Args:
            like: A model whose standstill to take over, so that two models differ by
                nothing but their effects.
        """
        rough = build_fitted_model(self.nominal, fitted)
        if like is not None:
            rough = replace(rough, standstill=like.standstill)
        else:
            rough = choose_standstill_behaviour(rough, self.logs.sketch)
        return _refitted(self, fitted, rough)


def search_effects(
    logs: FitLogs, nominal: NominalModel, rules: EvidenceThresholds, progress: Progress
) -> SearchOutcome:
    """Search, test and flag."""

    def searching(share: float) -> None:
        progress("search", share)

    design = build_first_design(logs, nominal)
    progress("features", 0.0)
    everything = build_candidates(design, nominal, logs.span, logs.clock is not None)
    selection = select_set_and_prior(
        PriorSpace(design, nominal), everything, rules, searching
    )
    if _needs_second_search(selection):
        settled = _refit_named(logs, nominal, selection)
        design.set_torque_model(
            keep_physical_terms(build_fitted_model(nominal, settled))
        )
        progress("features", 0.5)
        everything = recompute_candidates(design, everything)
        prior, wide = selection.task.prior, selection.wide
        again = replace(nominal, scale=prior.scale, widths=prior.widths)
        selection = select_set_and_prior(
            PriorSpace(design, again), everything, rules, searching
        )
        selection = replace(selection, wide=wide)
    progress("gate", 0.0)
    outcome = _tested(logs, nominal, selection)
    progress("gate", 1.0)
    return outcome


def search_without_names(
    outcome: SearchOutcome,
    withdrawn: Sequence[CandidateColumns],
    related: Sequence[CandidateColumns],
) -> SearchOutcome:
    """Search the same logs again without some names; every other one is tested anew.

    What a name has carried falls with it: a delay that was none must not leave the
    friction behind that it made room for. And what it hid may be found now.

    Args:
        outcome: The diagnosis so far; its prior is kept.
        withdrawn: What may not be named any more.
    """
    first = outcome.start.task
    task = replace(
        first, candidates=first.candidates.exclude_groups(withdrawn, related)
    )
    gone = {(g.effect.name, g.joints) for g in withdrawn}
    members = outcome.fit.members
    left = [g for g in members if (g.effect.name, g.joints) not in gone]
    left = task.settle(task.fit(left, outcome.start.fit, rounds=4))
    selection = replace(outcome.start, task=task, fit=left)
    return _tested(outcome.logs, outcome.nominal, selection, outcome.constants)


def _tested(
    logs: FitLogs,
    nominal: NominalModel,
    start: Selection,
    paid: tuple[int, ...] | None = None,
) -> SearchOutcome:
    """Put what a search found through the gate, and measure what remains.

    Args:
        start: What was found with every constant free.
        paid: Joints (from 0) whose constants paid in an earlier search; then what was
            found has yet to be searched for more.
    """
    selection, paying = constants.drop_unsupported_constants(start, nominal, paid)
    if paid is None:
        found = improve_set(selection.task, selection.fit)
        selection = replace(selection, fit=found)
    task, design = selection.task, selection.task.design
    fitted, tested = drop_members_failing_gate(
        task, swap_for_simpler_names(task, selection.fit)
    )
    curved = find_replaceable_by_curve(design, logs.sketch, fitted, tested)
    rest = [t for t in tested if t not in curved]
    if curved:
        fitted = task.settle(task.fit([t.group for t in rest], fitted))
    plain = task.settle(task.fit((), fitted, rounds=4))
    enough = _adequacy(logs, nominal, design, (plain, fitted))
    # Of those alone: what only draws a curve is out of the fit already.
    wrong = find_wrong_forms(design, logs.sketch, fitted, rest)
    kept = [t for t in rest if t not in wrong and not _resembles(t, enough)]
    if len(kept) < len(tested):
        fitted = task.settle(task.fit([t.group for t in kept], fitted))
    gone = tuple(t for t in tested if t not in kept)
    return SearchOutcome(
        logs,
        nominal,
        task,
        selection.wide,
        plain,
        fitted,
        tuple(kept),
        gone,
        enough,
        start,
        paying,
    )


def name_supported_constants(
    outcome: SearchOutcome, fitted: Fit
) -> tuple[SearchOutcome, list[GateResult]]:
    """The diagnosis with the constants that pay among its effects.

    Args:
        fitted: The fit of the names that stand.

    Returns:
        The diagnosis on the model as it was declared, and the constants as names.
    """
    if not outcome.nominal.constants:
        return replace(outcome, fit=fitted), []
    named = constants.convert_constants_to_effects(
        outcome.task, outcome.nominal, outcome.wide, outcome.constants
    )
    task, groups = named.task, named.groups
    full = task.settle(task.fit((*fitted.members, *groups), fitted, rounds=4))
    logs, nominal = outcome.logs, named.nominal
    enough = _adequacy(logs, nominal, task.design, (full, full))
    # On noise that is noise evidence counts, of constants too.
    own = [
        t
        for t in judge_members_by_gate(task, full)
        if t.group in groups
        and t.by
        and (t.nats >= task.rules.min_nats or t.joint in enough.doubted)
    ]
    if len(own) < len(groups):
        members = (*fitted.members, *(t.group for t in own))
        full = task.settle(task.fit(members, fitted, rounds=4))
    plain = task.settle(task.fit((), full, rounds=4))
    enough = _adequacy(logs, nominal, task.design, (plain, full))
    known = (*outcome.tested, *own)
    return (
        replace(
            outcome,
            task=task,
            nominal=named.nominal,
            wide=named.wide,
            plain=plain,
            fit=full,
            tested=known,
            adequacy=enough,
        ),
        own,
    )


def select_predictive_prior(outcome: SearchOutcome) -> SearchOutcome:
    """The same names with the scale of the bodies that predicts left-out parts best.

    Evidence compares scales as if noise were all that is left; on a measured arm it is
    not, and each of two halves takes another scale. So where some scale lowers the
    left-out error, in units of each joint's own, by ``scale_gain_share`` or more, the
    parameters are fitted at the best of them.
    """
    if outcome.logs.robot.prior_scale is not None:
        return outcome
    task, fitted = outcome.task, outcome.fit
    weight = 1 / fitted.variance / task.design.rows
    best, least = None, cross_validation_errors(task, fitted).sum(axis=0) @ weight
    least *= (1 - THRESHOLDS.scale_gain_share) ** 2
    for scale in OF_NAMES:
        widths = task.prior.widths
        prior = build_relative_prior(task.design, outcome.nominal, scale, widths)
        other = replace(task, prior=prior)
        fit_there = other.settle(other.fit(fitted.members, fitted, rounds=4))
        left = cross_validation_errors(other, fit_there).sum(axis=0) @ weight
        if left < least:
            best, least = (other, fit_there), left
    if best is None:
        return outcome
    task, fitted = best
    plain = task.settle(task.fit((), fitted, rounds=4))
    enough = _adequacy(outcome.logs, outcome.nominal, task.design, (plain, fitted))
    wide = max(outcome.wide, task.prior, key=lambda prior: prior.scale)
    changed = replace(outcome, task=task, wide=wide, plain=plain)
    return replace(changed, fit=fitted, adequacy=enough)


def _adequacy(
    logs: FitLogs, nominal: NominalModel, design: Design, fits: tuple[Fit, Fit]
) -> Adequacy:
    angles = torque_from_angle_noise(
        build_fitted_model(nominal, fits[1]), logs.sketch, logs.shaken
    )
    return assess_adequacy(design, logs.sketch, *fits, angles)


def _needs_second_search(selection: Selection) -> bool:
    """Whether a large effect, or one that reads the model's torque, was accepted."""
    fitted, task = selection.fit, selection.task
    if not fitted.members:
        return False
    if any(EffectTrait.USES_MODEL in g.effect.traits for g in fitted.members):
        return True
    plain = task.fit((), fitted, rounds=4)
    fall = np.maximum(plain.sse - fitted.sse, 0) / task.design.rows
    model_based = any(
        EffectTrait.USES_MODEL in e.traits for e in load_effects().values()
    )
    return model_based and bool(
        np.max(np.sqrt(fall) / task.design.rms) > THRESHOLDS.large_torque_share
    )


def _refit_named(logs: FitLogs, nominal: NominalModel, selection: Selection) -> Fit:
    """The named effects on columns of a model that has them: Gauss and Newton's way.

    A log that ends at a certain torque bends the model that its plateau is held
    against; so does a load that is still missing.
    """
    task, fitted = selection.task, selection.fit
    design = task.design
    for _ in range(THRESHOLDS.refit_rounds):
        design.set_torque_model(
            keep_physical_terms(build_fitted_model(nominal, fitted))
        )
        members = design.add([g.placed for g in fitted.members])
        searched = [g for g in members if g.effect.refine]
        for group in [g for g in searched if EffectTrait.USES_MODEL in g.effect.traits]:
            others = [g for g in members if g is not group]
            members = refine_last_shape(task, (*others, group), fitted)
        before, fitted = fitted.score, task.fit(members, fitted)
        if abs(fitted.score - before) < THRESHOLDS.steady_nats:
            break
    return fitted


def _resembles(tested: GateResult, enough: Adequacy) -> bool:
    """A name on a joint that keeps much may be a part of what is not known.

    On a flagged joint it must explain 3/4 of what was left. What claims the whole arm
    must explain more than remains of one that keeps much, too; of one joint's own
    friction or constant that was asked once, and cost true names only
    (docs/benchmarks.md).
    """
    local = tested.group.effect.scope in ("local", "pair")
    joints = set(tested.group.joints if local else (tested.joint,))
    if (
        joints & set(enough.flagged)
        and tested.share < THRESHOLDS.flagged_explained_share
    ):
        return True
    much = np.maximum(THRESHOLDS.veto_share, THRESHOLDS.veto_noises * enough.noise)
    doubted = (
        set() if local else joints & set(np.flatnonzero(enough.structured_share > much))
    )
    return any(tested.fall < enough.structured_share[j] for j in doubted)


def _refitted(outcome: SearchOutcome, fitted: Fit, rough: Model) -> PossibleModel:
    """Coefficients that go with a model's standstill and its own torque.

    A wide standstill changes friction on slow moving rows too, and features such as
    load friction read the model's torque: both are settled by one more fit.
    """
    nominal, tracks = outcome.nominal, outcome.logs.tracks
    base = replace(nominal.model, standstill=rough.standstill)
    design = Design(tracks, base, seen_with=rough)
    members = design.add([g.placed for g in fitted.members])
    final = fit_jointly(
        design, outcome.task.prior, members, fitted.counted, fitted.variance
    )
    model = build_fitted_model(replace(nominal, model=base), final)
    return fit_possible_bodies(design, final, model)


def remove_refuted_names(outcome: SearchOutcome, fitted: Fit) -> SearchOutcome:
    """The diagnosis with fewer names: what remains is measured anew."""
    if len(fitted.members) == len(outcome.fit.members):
        return outcome
    fits = outcome.plain, fitted
    design = outcome.task.design
    enough = _adequacy(outcome.logs, outcome.nominal, design, fits)
    return replace(outcome, fit=fitted, adequacy=enough)


def refit_members(outcome: SearchOutcome, tested: Sequence[GateResult]) -> Fit:
    """Fit again with some of the names only."""
    task = outcome.task
    members = [t.group for t in tested]
    return task.settle(
        fit_jointly(
            task.design, task.prior, members, outcome.fit.counted, None, rounds=4
        )
    )
