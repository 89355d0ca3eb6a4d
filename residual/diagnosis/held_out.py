"""What the held-out logs say of each name: confirmed, neutral or refuted."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.diagnosis.gate import GateResult, passes_gate
from residual.diagnosis.outcome import SearchOutcome, refit_members
from residual.diagnosis.search import (
    SearchTask,
    is_admissible,
    member_torque_shares,
    rank_additions,
    required_nats,
)
from residual.effects import load_effects
from residual.effects.base import EffectTrait
from residual.errors import InputError, format_joint_numbers
from residual.evidence.design import CandidateColumns, Design
from residual.evidence.fit import (
    Fit,
    FitEquations,
    PossibleModel,
    compute_evidence_gain,
    solve_minimum_norm,
)
from residual.evidence.priors import (
    SCALES,
    build_relative_prior,
    hold_coefficients,
    list_contradicted_coefficients,
)
from residual.evidence.thresholds import THRESHOLDS
from residual.model.compare import (
    ErrorSums,
    HeldOutLog,
    compute_error_rise,
    compute_joint_error_rises,
    compute_moving_error,
    compute_moving_power,
    prepare_held_out,
)
from residual.model.model import Model, Term
from residual.model.nominal import (
    DEFAULT_DECLARED,
    FitLogs,
    build_free_nominal,
    choose_standstill_behaviour,
)
from residual.recording import Array, Recording
from residual.verdict.result import Splits

ROUND = 3  # gains are compared to 0.1 %


@dataclass(frozen=True, eq=False, slots=True)
class HeldOutValidation:
    """Names that survive the held-out logs, and those that do not."""

    fit: Fit  # fit with the surviving names
    # Members with the gain of each: the part of its joint's error on held-out moving
    # samples that vanishes with it.
    kept: tuple[tuple[GateResult, float], ...]
    refuted: tuple[tuple[GateResult, float], ...]
    # Members that carry too little now that their fellows are refuted.
    dropped: tuple[GateResult, ...]


def validate_on_held_out(
    outcome: SearchOutcome, held_out: Sequence[HeldOutLog]
) -> HeldOutValidation:
    """Drop each name alone, refit the rest on the fit logs, predict the held-out logs.

    The worst refuted name goes first, then all are judged again.
    """
    tested, refuted, dropped = list(outcome.tested), [], []
    fitted = outcome.fit
    while True:
        gains = _held_out_gains(outcome, fitted, tested, held_out)
        if not gains or min(gains) >= 0:
            kept = tuple(zip(tested, gains, strict=True))
            return HeldOutValidation(fitted, kept, tuple(refuted), tuple(dropped))
        worst = int(np.argmin(gains))
        refuted.append((tested.pop(worst), gains[worst]))
        fitted = refit_members(outcome, tested)
        task, members = outcome.task, fitted.members
        alone = [t for t in tested if t.nats < required_nats(task, members, t.group)]
        if alone:
            tested = [t for t in tested if t not in alone]
            dropped += alone
            fitted = refit_members(outcome, tested)


def drop_names(
    outcome: SearchOutcome, validation: HeldOutValidation, dropped: Sequence[GateResult]
) -> HeldOutValidation:
    """Return the verdicts without some of the kept names, the rest refitted."""
    kept = tuple((t, gain) for t, gain in validation.kept if t not in dropped)
    return replace(
        validation, fit=refit_members(outcome, [t for t, _ in kept]), kept=kept
    )


def find_harmful_name(
    outcome: SearchOutcome,
    validation: HeldOutValidation,
    held_out: Sequence[HeldOutLog],
    excluded: Sequence[GateResult],
) -> list[tuple[GateResult, str]]:
    """The name that makes the arm worse than the refit without any name.

    Each may be harmless alone and all of them harm together: then the one goes without
    which it comes out best. Not of the company, which stands or falls together. A
    single joint that gets worse is said, and no reason: of names that fell by it all
    were true (docs/benchmarks.md).
    """
    alone = [t for t, _ in validation.kept if t not in excluded]
    if not alone:
        return []
    after = outcome.error(validation.fit, held_out).sum(axis=1)
    before = outcome.error(outcome.plain, held_out).sum(axis=1)
    larger = compute_error_rise(after, before)
    if not larger:
        return []

    def error_without(member: GateResult) -> float:
        return outcome.error(
            drop_names(outcome, validation, [member]).fit, held_out
        ).sum()

    why = f"it raises the held-out error over all joints by {100 * larger:.0f} %"
    return [(min(alone, key=error_without), f"withdrawn: {why}")]


def classify_gain(gain: float) -> str:
    """The verdict's word for a gain."""
    if gain < 0:
        return "refuted"
    return "confirmed" if gain >= THRESHOLDS.confirmed_gain else "neutral"


def build_three_models(
    outcome: SearchOutcome, validation: HeldOutValidation
) -> tuple[dict[str, Model], PossibleModel]:
    """The three models, and the bodies of the last.

    ValidatedIdentification and augmented differ by nothing but the effects.
    """
    bodies = outcome.model(validation.fit if validation.kept else outcome.plain)
    identified = augmented = bodies.model
    if validation.kept:
        identified = outcome.model(outcome.plain, like=augmented).model
    models = {"nominal": outcome.nominal.model, "identified": identified}
    return models | {"augmented": augmented}, bodies


def describe_unproven_joints(outcome: SearchOutcome, augmented: ErrorSums) -> list[str]:
    """Sentences on joints of which the logs prove nothing, or less than it seems."""
    out = []
    design, tracks = outcome.task.design, outcome.logs.tracks
    samples = sum(int(t.valid.sum()) for t in tracks)
    fit_errors = np.sqrt(outcome.fit.sse / design.rows) / design.rms
    held_out_errors = augmented.per_joint("moving") / 100
    for j in range(design.dof):
        if j in outcome.logs.too_small:
            out.append(
                f"joint {j + 1}: its torque is close to its resolution or noise, too "
                "small to diagnose"
            )
        elif design.rows[j] < THRESHOLDS.standing_row_share * samples:
            out.append(
                f"joint {j + 1} hardly moves in the fit logs and is not diagnosed"
            )
        elif held_out_errors[j] > max(
            THRESHOLDS.held_out_error_ratio * fit_errors[j],
            THRESHOLDS.held_out_error_share,
        ):
            times = held_out_errors[j] / max(fit_errors[j], 1e-6)
            out.append(
                f"joint {j + 1}: the error on held-out moving samples "
                f"({100 * held_out_errors[j]:.1f} %) is {times:.0f} times that of the "
                "fit logs; the held-out motion holds something that the "
                "fit motion does not determine"
            )
    return out


def _held_out_gains(
    outcome: SearchOutcome,
    fitted: Fit,
    tested: Sequence[GateResult],
    held_out: Sequence[HeldOutLog],
) -> list[float]:
    """What of the error vanishes with each name, beside the others.

    Only joints count on which it acts, or on which it shows.
    """
    with_all = outcome.error(fitted, held_out)
    rms, out = outcome.task.design.rms, []
    for member in tested:
        others = refit_members(outcome, [t for t in tested if t is not member])
        without = outcome.error(others, held_out)
        fall = _error_fall(member, with_all, without, rms)
        if fall < THRESHOLDS.confirmed_gain and (
            held_fit := _at_nominal(outcome, tested, member)
        ):
            # The refit imitates it: then it is held against the value as given.
            fall = _error_fall(member, with_all, outcome.error(held_fit, held_out), rms)
        out.append(round(fall, ROUND))
    return out


def _at_nominal(
    outcome: SearchOutcome, tested: Sequence[GateResult], member: GateResult
) -> Fit | None:
    """The fit without a wrong value, that value and no other held as it was given.

    Of a body all bodies are held: its neighbours would say what it may not. None where
    the name is no value that the model has.
    """
    slots = list_contradicted_coefficients(outcome.nominal.model, member.group)
    if not len(slots):
        return None
    task = outcome.task
    members = [t.group for t in tested if t is not member]
    held_task = replace(task, prior=hold_coefficients(task.prior, slots))
    return held_task.settle(held_task.fit(members, outcome.fit, rounds=4))


def _error_fall(
    member: GateResult, with_it: Array, without: Array, rms: Array
) -> float:
    """1 - error with over error without, where the effect acts and where it shows.

    Parameters that bend without the name may predict the same. So a rise by chance is
    none, and neither is a fall where the name only spares the parameters.
    """
    effect, dof = member.group.effect, len(rms)
    joints = sorted({*effect.rows(member.group.joints, dof), member.shown_joint})
    after, before = ((e / rms**2)[:, joints].sum(axis=1) for e in (with_it, without))
    change = before - after
    if change.sum() < 0:
        return -compute_error_rise(after, before)
    scatter = np.sqrt(((change - change.mean()) ** 2).sum())
    if (
        member.by == "plausibility"
        and change.sum() < THRESHOLDS.spared_deviations * scatter
    ):
        return 0.0
    return float(1 - np.sqrt(after.sum() / before.sum())) if before.sum() > 0 else 0.0


PARTS = 3
SHARE = 1 - 1 / PARTS  # of the evidence that is left in what remains


def count_confirming_splits(
    task: SearchTask, fitted: Fit, tested: Sequence[GateResult]
) -> list[Splits]:
    """Leave out each third of the data and let each name win its place anew.

    Beside the other names it must again carry its threshold's share, help as a name
    must, and have no better rival than what cannot be told from it.
    """
    if not tested:
        return []
    hits, shown_parts = (
        np.zeros(len(tested), dtype=int),
        np.zeros(len(tested), dtype=int),
    )
    for left_out_folds in np.array_split(np.arange(task.design.folds), PARTS):
        part = task.design.part(
            np.setdiff1d(np.arange(task.design.folds), left_out_folds)
        )
        rules = replace(task.rules, min_nats=SHARE * task.rules.min_nats)
        part_task = replace(task, design=part, rules=rules)
        refitted = part_task.settle(part_task.fit(fitted.members, fitted, rounds=4))
        for i, t in enumerate(tested):
            shown = _has_share(task.design, part, fitted, t.group)
            shown_parts[i] += shown
            hits[i] += shown and _wins_again(part_task, refitted, t.group)
    return [Splits(int(k), int(n)) for k, n in zip(hits, shown_parts, strict=True)]


def _wins_again(task: SearchTask, fitted: Fit, group: CandidateColumns) -> bool:
    """Whether these logs alone would name a member, given the others."""
    if EffectTrait.CONSTANT in group.effect.traits:
        return passes_gate(task, fitted, group)
    others = [g for g in fitted.members if g is not group]
    without = task.settle(task.fit(others, fitted))
    value, big, small = compute_evidence_gain(task.design, task.prior, fitted, without)
    net = value - task.candidates.cost(group)
    if net < task.rules.min_nats or not is_admissible(task, group, value, big, small):
        return False
    rivals = rank_additions(task, without, instead=group)
    family = group.effect.family
    others_nats = [v for v, g, _ in rivals if not family or g.effect.family != family]
    return max(others_nats, default=-np.inf) < net + THRESHOLDS.class_nats


def _has_share(
    full_design: Design, part_design: Design, fitted: Fit, group: CandidateColumns
) -> bool:
    part_power, whole_power = (
        np.sum(member_torque_shares(design, fitted, group) ** 2 * design.rows)
        for design in (part_design, full_design)
    )
    return bool(part_power > THRESHOLDS.part_power_share * whole_power)


# What a model is worth on motion that it was not fitted to: may it be adopted?
#
# Each effect that is new in it is taken out again, and nothing is refitted. Held-out
# motion must then show it, on that joint and of about that size: the part of it that
# lowers the error most is 1 for a right one, 0 on a wrong joint, -1 with a wrong sign,
# and 0.5 where it is twice as large as it should be.


@dataclass(frozen=True, slots=True)
class VisibleShare:
    """How much of a new effect held-out motion shows."""

    name: str  # the effect
    joints: tuple[int, ...]  # joints from 1; empty for the whole arm
    # 1 where it is there as the model has it; None where the motion does not show it.
    part: float | None

    @property
    def doubt(self) -> str | None:
        """Why it is not as the model has it, None where nothing speaks against it."""
        if (
            self.part is None
            or THRESHOLDS.min_shown_share <= self.part <= THRESHOLDS.max_shown_share
        ):
            return None
        where = f" on {format_joint_numbers(self.joints)}" if self.joints else ""
        low, high = THRESHOLDS.min_shown_share, THRESHOLDS.max_shown_share
        return (
            f"held-out motion shows {self.part:.2f} times the {self.name}{where} of "
            f"the model, expected {low:g} to {high:g}"
        )


@dataclass(frozen=True, slots=True)
class AdoptionCheck:
    """What a model is worth beside the one before it."""

    # Error of all joints on held-out moving samples [%].
    before: float
    after: float
    effects: tuple[VisibleShare, ...]  # what is new in it
    # Why it should not be adopted, in sentences; empty for a model that may.
    doubts: tuple[str, ...]


def check_adoption(
    model: Model, before: Model, held_out: Sequence[Recording]
) -> AdoptionCheck:
    """Hold a model against the one before it, on logs that neither was fitted to.

    Raises:
        InputError: If there is no log.
    """
    if not held_out:
        raise InputError("No held-out log given to test the model on.")
    logs = prepare_held_out(held_out, model)
    after, then = compute_moving_error(model, logs), compute_moving_error(before, logs)
    power = compute_moving_power(logs)
    had = {(t.effect.name, t.joints) for t in before.terms}
    new = [t for t in model.terms if (t.effect.name, t.joints) not in had]
    effects = tuple(_visible_share(model, term, logs) for term in new)
    figures = [100 * float(np.sqrt(e.sum() / power.sum())) for e in (then, after)]
    # What a name must lower an error by at least, a model may raise one by.
    larger = compute_joint_error_rises(after, then, power, THRESHOLDS.min_fall)
    doubts = [
        *_no_better(after, then),
        *(
            f"the error of joint {j + 1} on held-out motion rises by "
            f"{100 * larger[j]:.0f} %"
            for j in np.flatnonzero(larger)
        ),
    ]
    doubts += [e.doubt for e in effects if e.doubt]
    if effects and all(e.part is None for e in effects):
        doubts.append("held-out motion shows none of its new effects")
    return AdoptionCheck(*figures, effects, tuple(doubts))


def _no_better(after: Array, before: Array) -> list[str]:
    change = (before - after).sum(axis=1)
    scatter = float(np.sqrt(((change - change.mean()) ** 2).sum()))
    if change.sum() > THRESHOLDS.spared_deviations * scatter:
        return []
    factor = float(np.sqrt(after.sum() / max(before.sum(), 1e-30)))
    return [
        f"the error on held-out motion is {factor:.2f} times that of the model before, "
        "no significant improvement"
    ]


def _visible_share(
    model: Model, term: Term, logs: Sequence[HeldOutLog]
) -> VisibleShare:
    """Weighted least squares of the residual without an effect on its torque."""
    without_term = replace(model, terms=tuple(t for t in model.terms if t is not term))
    torques, residuals = [], []
    for log in logs:
        track = log.track
        with_term, without = (
            track.filter(m.torque_on(track)) for m in (model, without_term)
        )
        torques.append((with_term - without) * track.moving)
        residuals.append((track.tau - without) * track.moving)
    effect, gap = np.concatenate(torques), np.concatenate(residuals)
    # Each joint counts by how well the model knows it.
    weight = 1 / np.maximum(np.mean((gap - effect) ** 2, axis=0), 1e-12)
    torque = np.sqrt(compute_moving_power(logs) / len(effect))
    visible = np.sqrt(
        np.mean(effect**2, axis=0)
    ) > THRESHOLDS.silent_torque_share * np.maximum(torque, 1e-12)
    joints = tuple(j + 1 for j in term.joints)
    if not visible.any():
        return VisibleShare(term.effect.name, joints, None)
    part = (weight * effect * gap).sum() / (weight * effect**2).sum()
    return VisibleShare(term.effect.name, joints, float(part))


# The yardstick that anyone has at hand: plain least squares, on the same logs.
#
# All inertial parameters, the drive's rotor, Coulomb and viscous friction and a
# constant torque of every joint, all free, every joint's error weighed alike. A
# diagnosis that predicts worse than that is not worth its names, so it is held against
# it on the held-out logs.


def fit_least_squares_model(logs: FitLogs) -> Model:
    """Fit a robot's logs by plain least squares."""
    constant = (
        e.name for e in load_effects().values() if EffectTrait.CONSTANT in e.traits
    )
    nominal = build_free_nominal(logs, (*DEFAULT_DECLARED, *constant))
    design = Design(logs.tracks, nominal.model)
    whole = FitEquations.of(
        design, build_relative_prior(design, nominal, SCALES[-1]), ()
    )
    least = solve_minimum_norm(whole.gram.sum(axis=0), whole.cross.sum(axis=0))
    model = nominal.model.with_coefficients(nominal.model.coefficients() + least)
    return choose_standstill_behaviour(model, logs.sketch)
