"""Which names stand: each is doubted in turn; where one falls, the search starts anew.

What a false name explained was taken from others, and what it made room for leans on
it. So whenever one falls, everything is searched again without it, and every other name
has to win its place anew.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from residual.diagnosis.errors_in_variables import (
    AngleNoiseCheck,
    check_angle_noise,
    drop_noise_artifacts,
)
from residual.diagnosis.findings import NamedEffect, merge_into_findings
from residual.diagnosis.gate import GateResult
from residual.diagnosis.held_out import (
    HeldOutValidation,
    count_confirming_splits,
    drop_names,
    find_harmful_name,
    validate_on_held_out,
)
from residual.diagnosis.outcome import (
    Progress,
    SearchOutcome,
    name_supported_constants,
    refit_members,
    remove_refuted_names,
    search_without_names,
    select_predictive_prior,
)
from residual.diagnosis.search import required_nats
from residual.effects.base import EffectTrait
from residual.errors import join_with_commas
from residual.evidence.design import CandidateColumns
from residual.evidence.fit import build_fitted_model, fit_possible_bodies
from residual.evidence.thresholds import THRESHOLDS
from residual.model.compare import HeldOutLog
from residual.recording import Recording
from residual.verdict.result import Splits

SURE = 0.9  # probability from which a name is in the model and in the headline
MOST_GAIN = 0.3  # more of a gain makes no name surer
# Gain from which a name is something although each of its sizes may be nothing: a
# gap whose flight is another than the formula's takes an eighth of its joint's error.
PROVEN = 0.1


@dataclass(frozen=True, slots=True)
class ConfidenceCurve:
    """Log odds of a name: a level, and weights of what speaks for it."""

    level: float
    nats: float  # of log(1 + nats)
    parts: float  # of the share of parts of the logs that show it again
    gain: float  # of the part of the held-out error that it removes, over MOST_GAIN


# 70 names of 8 measured arms, seed 1 of `benchmarks/measured_parts/added.py`.
CURVE = ConfidenceCurve(level=-3.10, nats=0.41, parts=1.88, gain=2.59)
# Of a constant, whose evidence is no measure (it is tested on left-out parts): 24 of
# the same and of simulated arms; the level 0.2 under the fit, as few of them are false.
OF_CONSTANTS = ConfidenceCurve(level=-1.60, nats=0.0, parts=2.34, gain=3.28)


def name_probability(tested: GateResult, gain: float, splits: Splits) -> float:
    """Probability that a name is right, on a joint that keeps more than noise.

    Args:
        gain: Part of the held-out error that it removes.
        splits: How many parts of the logs show it again.
    """
    curve = (
        OF_CONSTANTS if EffectTrait.CONSTANT in tested.group.effect.traits else CURVE
    )
    parts = splits.found / splits.of if splits.of else 0.5
    gained = float(np.clip(gain / MOST_GAIN, -1.0, 1.0))
    odds = curve.level + curve.nats * np.log1p(max(tested.nats, 0.0))
    odds += curve.parts * parts + curve.gain * gained
    return float(1 / (1 + np.exp(-odds)))


# Names that came up in the place of others that fell.
#
# Whoever asks one candidate after another gets a yes by chance in the end, and what a
# fallen name explained is still there: anything that looks like it will be glad to.


def find_substitute_names(
    outcome: SearchOutcome,
    validation: HeldOutValidation,
    held_out: Sequence[HeldOutLog],
    late_names: Sequence[GateResult],
    withdrawn_groups: Sequence[CandidateColumns],
) -> list[tuple[GateResult, str]]:
    """Return the late names that only say what a fallen one said, or prove nothing.

    Args:
        late_names: Those of the names that an earlier search had not found.
        withdrawn_groups: What fell although it explained much.
    """
    out = []
    for member in late_names:
        if not _is_more(outcome, validation, member, withdrawn_groups):
            out.append((member, "withdrawn: it only repeats a withdrawn effect"))
        elif not _is_proven(outcome, validation, held_out, member):
            why = "it replaces a withdrawn effect without a clear held-out gain"
            out.append((member, f"withdrawn: {why}"))
    return out


def _is_more(
    outcome: SearchOutcome,
    validation: HeldOutValidation,
    member: GateResult,
    fallen: Sequence[CandidateColumns],
) -> bool:
    """Whether a name passes the threshold with the withdrawn names in the fit."""
    task = outcome.task
    names = [t.group for t, _ in validation.kept if t is not member]
    without = task.settle(task.fit((*names, *fallen), validation.fit))
    with_it = task.settle(task.fit((*names, *fallen, member.group), validation.fit))
    return task.net_gain(with_it, without, member.group) >= task.rules.min_nats


def _is_proven(
    outcome: SearchOutcome,
    validation: HeldOutValidation,
    held_out: Sequence[HeldOutLog],
    member: GateResult,
) -> bool:
    """Whether a name lowers the held-out error significantly where it acts."""
    rest = refit_members(outcome, [t for t, _ in validation.kept if t is not member])
    after = outcome.error(validation.fit, held_out)
    before = outcome.error(rest, held_out)
    rms = outcome.task.design.rms
    joints = sorted(
        {*member.group.effect.rows(member.group.joints, len(rms)), member.shown_joint}
    )
    fall = ((before - after) / rms**2)[:, joints].sum(axis=1)
    scatter = np.sqrt(((fall - fall.mean()) ** 2).sum())
    return bool(fall.sum() >= THRESHOLDS.late_deviations * scatter)


NOISE = "withdrawn: encoder noise explains all or much of it"
UNLIKELY = "withdrawn: another effect is more likely"
ALONE = "withdrawn: its evidence is too weak without the refuted effects"


@dataclass(frozen=True, eq=False, slots=True)
class WithdrawnName:
    """A name that did not stand."""

    tested: GateResult  # the name
    why: str  # in words
    # Whether it explained much of the fit logs all the same. Then nothing may take its
    # place that would only say the same in other words.
    explains: bool = False
    # Whether its family falls with it, which would say the same, only worse; else it
    # was only the wrong one of it.
    with_related: bool = False


@dataclass(frozen=True, eq=False, slots=True)
class ConfirmedNames:
    """What stands after every name was doubted."""

    outcome: SearchOutcome  # the diagnosis of the last search
    validation: HeldOutValidation  # its names with their gain on held-out motion
    # What noise of the angles does to their fit; None where nobody looked.
    checks: AngleNoiseCheck | None
    named: tuple[NamedEffect, ...]  # the findings, most important first
    splits: dict[GateResult, Splits]  # how often each tested name was found again
    withdrawn: tuple[WithdrawnName, ...]  # names that fell, of all searches
    suspected: tuple[NamedEffect, ...] = ()  # what is less sure, and in no model
    gains: Mapping[GateResult, float] = field(default_factory=dict)  # of all that stood


def withdraw_doubtful_names(
    outcome: SearchOutcome,
    held_out: Sequence[HeldOutLog],
    recordings: Sequence[Recording],
    progress: Progress,
) -> ConfirmedNames:
    """Doubt every name; search again without those that fall, until none does.

    Args:
        recordings: The fit logs, in the diagnosis' order.
    """
    gone: list[WithdrawnName] = []
    first = {_place_of(t) for t in (*outcome.tested, *outcome.withdrawn)}
    for turn in range(1, THRESHOLDS.doubt_rounds + 1):
        last = turn == THRESHOLDS.doubt_rounds
        fallen = [w.tested.group for w in gone if w.explains]
        now = _doubt_once(outcome, held_out, recordings, first, fallen, last)
        gone += now.withdrawn
        progress("proof", turn / (THRESHOLDS.doubt_rounds + 1))
        if not now.withdrawn or last:
            break
        kin = [w.tested.group for w in gone if w.with_related]
        outcome = search_without_names(outcome, [w.tested.group for w in gone], kin)
    now = _with_constants(replace(now, withdrawn=tuple(gone)), held_out, recordings)
    known = {_place_of(t) for f in now.named for t in f.tested}
    gone = [w for w in now.withdrawn if _place_of(w.tested) not in known]
    tested = [t for t, _ in now.validation.kept]
    again = count_confirming_splits(now.outcome.task, now.validation.fit, tested)
    splits = dict(zip(tested, again, strict=True))
    now = replace(now, splits=splits, withdrawn=tuple(gone))
    return _split_suspected(now, held_out, recordings)


def _split_suspected(
    now: ConfirmedNames, proof: Sequence[HeldOutLog], recordings: Sequence[Recording]
) -> ConfirmedNames:
    """Part the sure names from the suspected ones, which are in no model."""
    probabilities = _confidences(now)
    gains = dict(now.validation.kept)
    every = [_with_confidence(f, probabilities, gains) for f in now.named]
    weak = {
        t
        for f in every
        for t, s in zip(f.tested, f.confidences, strict=True)
        if s.probability < SURE
    }
    suspected = [part for f in every if (part := f.select_members(weak))]
    validation = (
        drop_names(now.outcome, now.validation, list(weak)) if weak else now.validation
    )
    first = replace(
        remove_refuted_names(now.outcome, validation.fit), fit=validation.fit
    )
    outcome = select_predictive_prior(first)
    if outcome is not first:
        tested = tuple(t for t, _ in validation.kept)
        revalidated = validate_on_held_out(replace(outcome, tested=tested), proof)
        # A scale that a name does not stand at is none to take.
        stand_all = len(revalidated.kept) == len(tested)
        validation, outcome = (
            (revalidated, outcome) if stand_all else (validation, first)
        )
    if outcome is first and not weak:
        return replace(now, outcome=first, named=tuple(every))
    remaining = [t for t, _ in validation.kept]
    checks = (
        check_angle_noise(outcome, validation.fit, recordings) if remaining else None
    )
    named = merge_into_findings(outcome, validation.fit, remaining, checks)
    unlikely = _find_unlikely(named, _common_names(outcome, validation))
    if outcome is not first and unlikely:
        validation = drop_names(outcome, validation, unlikely)
        outcome = remove_refuted_names(outcome, validation.fit)
        gone = tuple(WithdrawnName(t, UNLIKELY) for t in unlikely)
        now = replace(now, withdrawn=(*now.withdrawn, *gone))
        remaining = [t for t, _ in validation.kept]
        checks = (
            check_angle_noise(outcome, validation.fit, recordings)
            if remaining
            else None
        )
        named = merge_into_findings(outcome, validation.fit, remaining, checks)
    return replace(
        now,
        outcome=outcome,
        validation=validation,
        checks=checks,
        named=tuple(_with_confidence(f, probabilities, gains) for f in named),
        suspected=tuple(suspected),
        gains=gains,
    )


def _find_unlikely(
    named: Sequence[NamedEffect], company: Sequence[GateResult]
) -> list[GateResult]:
    """Names that another is likelier than, at another scale of the bodies.

    Not a constant, of which evidence is no measure.
    """
    return [
        t
        for finding in named
        for t, sure in zip(finding.tested, finding.confidences, strict=True)
        if sure.probability < THRESHOLDS.min_probability
        and t not in company
        and EffectTrait.CONSTANT not in t.group.effect.traits
    ]


def _confidences(now: ConfirmedNames) -> dict[GateResult, float]:
    """Confidence of each name; common names of all drives share one."""
    doubted = now.outcome.adequacy.doubted
    probability = {
        t: name_probability(t, gain, now.splits[t]) if t.joint in doubted else 1.0
        for t, gain in now.validation.kept
    }
    company = _common_names(now.outcome, now.validation)
    for name in {t.group.effect.name for t in company}:
        members = [t for t in company if t.group.effect.name == name]
        probability |= dict.fromkeys(members, max(probability[t] for t in members))
    return probability


def _with_confidence(
    finding: NamedEffect,
    probabilities: Mapping[GateResult, float],
    gains: Mapping[GateResult, float],
) -> NamedEffect:
    """A finding with the probability of each member: right, and not another name.

    It is half of that where every size may be nothing and held-out motion gains little.
    """
    sureness = []
    for t, s, clear in zip(
        finding.tested, finding.confidences, finding.size_is_significant, strict=True
    ):
        # Of a constant evidence is no measure, and what could stand in its place is
        # said beside it.
        constant = EffectTrait.CONSTANT in t.group.effect.traits
        probability = probabilities[t] * (1.0 if constant else s.probability)
        significant = clear or gains[t] >= PROVEN
        sureness.append(
            replace(s, probability=probability if significant else probability / 2)
        )
    return replace(finding, confidences=tuple(sureness))


def _with_constants(
    now: ConfirmedNames, proof: Sequence[HeldOutLog], recordings: Sequence[Recording]
) -> ConfirmedNames:
    outcome, own = name_supported_constants(now.outcome, now.validation.fit)
    if not own:
        validation = replace(now.validation, fit=outcome.fit)
        return replace(now, outcome=outcome, validation=validation)
    names = [t for t, _ in now.validation.kept]
    every = replace(outcome, tested=(*names, *own))
    validation = validate_on_held_out(every, proof)
    gone = [WithdrawnName(t, _refuted(gain)) for t, gain in validation.refuted]
    tested = [t for t, _ in validation.kept]
    checks = check_angle_noise(outcome, validation.fit, recordings) if tested else None
    return replace(
        now,
        outcome=outcome,
        validation=validation,
        checks=checks,
        named=tuple(merge_into_findings(outcome, validation.fit, tested, checks)),
        withdrawn=(*now.withdrawn, *gone),
    )


def _doubt_once(
    outcome: SearchOutcome,
    proof: Sequence[HeldOutLog],
    recordings: Sequence[Recording],
    first: Collection[tuple],
    earlier: Sequence[CandidateColumns],
    last: bool,
) -> ConfirmedNames:
    """Put the names of one search through every doubt.

    The first doubt that one falls by ends the round, since the others lean on it and
    deserve a search without it; in the last round they are doubted on.

    Args:
        first: Places of the names of the first search.
        earlier: What fell of earlier searches although it explained much.
    """
    validation = validate_on_held_out(outcome, proof)
    gone = [
        WithdrawnName(
            t,
            f"withdrawn: the residual of joint {t.joint + 1} resembles it, but it does "
            "not explain the residual",
            True,
            True,
        )
        for t in outcome.withdrawn
    ]
    gone += [
        WithdrawnName(t, _refuted(gain), True, True) for t, gain in validation.refuted
    ]
    if last:
        gone += [WithdrawnName(t, ALONE) for t in validation.dropped]
    checks, named = None, []
    while last or not gone:
        validation, checks, noise = drop_noise_artifacts(
            outcome, validation, recordings
        )
        tested = [t for t, _ in validation.kept]
        named = merge_into_findings(outcome, validation.fit, tested, checks)
        company = _common_names(outcome, validation)
        fallen = [(t, NOISE) for t in noise] or _find_weak(named, company)
        fallen = fallen or _find_bodiless(outcome, validation)
        harm = [] if fallen else find_harmful_name(outcome, validation, proof, company)
        fallen = fallen or harm
        late = [t for t in tested if _place_of(t) not in first]
        fallen = fallen or find_substitute_names(
            outcome, validation, proof, late, earlier
        )
        if not fallen:
            break
        gone += [WithdrawnName(t, why, explains=bool(harm)) for t, why in fallen]
        validation = drop_names(outcome, validation, [t for t, _ in fallen])
    return ConfirmedNames(outcome, validation, checks, tuple(named), {}, tuple(gone))


def _common_names(
    outcome: SearchOutcome, validation: HeldOutValidation
) -> list[GateResult]:
    """Names that stand on half of the arm's joints or more, and came together.

    What every drive has is not asked joint by joint: where one hardly turned, its
    friction is no less likely for it.
    """
    members, task = validation.fit.members, outcome.task
    return [t for t, _ in validation.kept if required_nats(task, members, t.group) < 0]


def _find_weak(
    named: Sequence[NamedEffect], company: Sequence[GateResult]
) -> list[tuple[GateResult, str]]:
    """Names that are improbable, or not significantly different from zero."""
    out = []
    for finding in named:
        for tested, sure in zip(finding.tested, finding.confidences, strict=True):
            if tested in company:
                continue
            if sure.probability < THRESHOLDS.min_probability:
                out.append((tested, UNLIKELY))
            elif sure.chance > (
                THRESHOLDS.link_zero_chance
                if tested.group.effect.replaces_link
                else THRESHOLDS.zero_chance
            ):
                why = "withdrawn: its size is not significantly different from zero"
                out.append((tested, why))
    return out


def _find_bodiless(
    outcome: SearchOutcome, validation: HeldOutValidation
) -> list[tuple[GateResult, str]]:
    """Names of bodies, where the logs exclude every possible body."""
    named = [t for t, _ in validation.kept if EffectTrait.BODY in t.group.effect.traits]
    if not named:
        return []
    model = build_fitted_model(outcome.nominal, validation.fit)
    made = fit_possible_bodies(outcome.task.design, validation.fit, model)
    if made.correction is None or not made.contradicted:
        return []
    bodies = join_with_commas(made.correction.bodies)
    why = f"withdrawn: the logs give physically impossible inertias for {bodies}"
    return [(t, why) for t in named]


def _place_of(tested: GateResult) -> tuple:
    return tested.group.effect.name, tested.group.joints


def _refuted(gain: float) -> str:
    return (
        "refuted by the held-out logs "
        f"(error there {100 * -gain:.1f} % higher with it), withdrawn"
    )


def split_background(
    named: Sequence[NamedEffect], dof: int
) -> tuple[tuple[NamedEffect, ...], tuple[NamedEffect, ...]]:
    """Part the findings into those to be listed and those to be folded.

    Folded is friction or ripple of a size that the joints have anyway, beside something
    much larger, where half of the joints have such: one alone is a finding.

    Returns:
        What is listed, and what is folded, in the same order.
    """
    if not named:
        return tuple(named), ()
    largest = max(f.torque.max() for f in named)
    small = [
        f for f in named if _is_background(f, THRESHOLDS.background_share * largest)
    ]
    if len({j for f in small for j in f.joints}) < max(
        THRESHOLDS.usual_joint_share * dof, THRESHOLDS.usual_min_joints
    ):
        small = []
    return tuple(f for f in named if f not in small), tuple(small)


def _is_background(finding: NamedEffect, least: float) -> bool:
    effect = finding.effect
    small = effect.traits & (EffectTrait.FRICTION | EffectTrait.PERIODIC)
    if not small or effect.scope != "local":
        return False
    return bool(np.all(finding.torque < min(THRESHOLDS.usual_torque_share, least)))
