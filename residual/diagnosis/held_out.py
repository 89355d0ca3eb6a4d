"""The held-out logs, read once, after every choice: errors, and a test of each name."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from residual.diagnosis.outcome import Outcome
from residual.diagnosis.select import Member
from residual.effects import load_effects
from residual.effects.base import EffectTrait
from residual.evidence.design import Design
from residual.evidence.fit import FitEquations, PossibleModel, solve_minimum_norm
from residual.evidence.priors import SCALES, build_relative_prior
from residual.evidence.thresholds import THRESHOLDS
from residual.model.compare import ErrorSums, HeldOutLog, compute_error_rise, find_worse_joints
from residual.model.dynamics import compute_position_errors
from residual.model.model import Model
from residual.model.nominal import (
    DEFAULT_DECLARED,
    FitLogs,
    build_free_nominal,
    choose_standstill_behaviour,
)
from residual.recording import Array, Recording
from residual.verdict.diagnosis import tabulate_errors
from residual.verdict.result import PLAIN, STAGES, ErrorTables

ROUND = 3  # gains are compared to 0.1 %


@dataclass(frozen=True, eq=False, slots=True)
class Proof:
    """The test of the names on held-out logs, without a new search."""

    outcome: Outcome  # without the refuted names, the others refitted on the fit logs
    # Share of its joint's error on held-out moving samples that each name removes.
    gains: dict[Member, float]
    refuted: tuple[Member, ...]


def prove(outcome: Outcome, held_out: Sequence[HeldOutLog]) -> Proof:
    """Drop each name alone, refit the others on the fit logs, predict the held-out logs.

    The worst refuted name leaves the model first, then all are tested again.
    """
    gains: dict[Member, float] = {}
    refuted: list[Member] = []
    while True:
        named = outcome.named
        error = outcome.error(outcome.fit, held_out) if named else np.zeros(0)
        now = {m: _gain(outcome, m, held_out, error) for m in named}
        gains |= now
        if not now or min(now.values()) >= 0:
            return Proof(outcome, gains, tuple(refuted))
        worst = min(now, key=now.__getitem__)
        refuted.append(worst)
        outcome = outcome.with_names([m for m in named if m is not worst])


def classify_gain(gain: float) -> str:
    """Return the class of a gain: confirmed, neutral or refuted."""
    if gain < 0:
        return "refuted"
    return "confirmed" if gain >= THRESHOLDS.confirmed_gain else "neutral"


def _gain(
    outcome: Outcome, member: Member, held_out: Sequence[HeldOutLog], with_it: Array
) -> float:
    """Share of the error that a name removes, on joints where it acts or shows.

    If the refit imitates a wrong value, it is compared with the value as given.
    """
    rest = [m for m in outcome.named if m is not member]
    without = outcome.error(outcome.refit(rest), held_out)
    fall = _error_fall(outcome.design, member, with_it, without)
    if fall < THRESHOLDS.confirmed_gain and (held := outcome.fit_at_nominal(member)):
        fall = _error_fall(outcome.design, member, with_it, outcome.error(held, held_out))
    return round(fall, ROUND)


def _error_fall(design: Design, member: Member, with_it: Array, without: Array) -> float:
    """1 - error with over error without, where the effect acts and where it shows.

    Refitted parameters may predict as well without the name: a chance rise counts as
    zero.
    """
    effect = member.group.effect
    joints = sorted({*effect.rows(member.group.joints, design.dof), member.shown_joint})
    after, before = ((e / design.rms**2)[:, joints].sum(axis=1) for e in (with_it, without))
    if after.sum() > before.sum():
        return -compute_error_rise(after, before)
    return float(1 - np.sqrt(after.sum() / before.sum())) if before.sum() > 0 else 0.0


def build_three_models(outcome: Outcome) -> tuple[dict[str, Model], PossibleModel]:
    """The three models, and the bodies of the last.

    `identified` and `augmented` differ only in the named effects.
    """
    bodies = outcome.model(outcome.fit)
    identified = augmented = bodies.model
    if outcome.named:
        identified = outcome.model(outcome.plain, like=augmented).model
    models = {"nominal": outcome.nominal.model, "identified": identified}
    return models | {"augmented": augmented}, bodies


def tabulate_held_out_errors(
    models: Mapping[str, Model],
    errors: Mapping[str, ErrorSums],
    held: Sequence[HeldOutLog],
    held_out: Sequence[Recording],
    logs: FitLogs,
    same_run: bool,
) -> ErrorTables:
    """The verdict's tables of errors, of torque and of position.

    Args:
        errors: Of each model on the held-out logs.
        held: These logs, prepared.
        same_run: Whether they are part of a fit log.
    """
    return tabulate_errors(
        {name: errors.get(name) for name in (*STAGES, PLAIN)},
        min(t.cutoff for t in logs.tracks),
        [r.id for r in held_out],
        same_run,
        find_worse_joints(models, held),
        compute_position_errors({k: models[k] for k in STAGES[:3]}, held_out),
    )


def describe_unproven_joints(outcome: Outcome, augmented: ErrorSums) -> list[str]:
    """Sentences on joints for which the held-out logs are a weak or no test."""
    out = []
    design, tracks = outcome.design, outcome.logs.tracks
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
            out.append(f"joint {j + 1} hardly moves in the fit logs and is not diagnosed")
        elif held_out_errors[j] > max(
            THRESHOLDS.held_out_error_ratio * fit_errors[j], THRESHOLDS.held_out_error_share
        ):
            times = held_out_errors[j] / max(fit_errors[j], 1e-6)
            out.append(
                f"joint {j + 1}: the error on held-out moving samples "
                f"({100 * held_out_errors[j]:.1f} %) is {times:.0f} times that of the "
                "fit logs; the held-out motion holds something that the "
                "fit motion does not determine"
            )
    return out


# The common reference: plain least squares, on the same logs.
#
# All inertial parameters, the drive's rotor, Coulomb and viscous friction and a
# constant torque of every joint, all free, with equal weights of all joints. A diagnosis
# that predicts worse has no useful names, so both are compared on the held-out logs.


def fit_least_squares_model(logs: FitLogs) -> Model:
    """Fit a robot's logs by plain least squares."""
    constant = (e.name for e in load_effects().values() if EffectTrait.CONSTANT in e.traits)
    nominal = build_free_nominal(logs, (*DEFAULT_DECLARED, *constant))
    design = Design(logs.tracks, nominal.model)
    whole = FitEquations.of(design, build_relative_prior(design, nominal, SCALES[-1]), ())
    least = solve_minimum_norm(whole.gram.sum(axis=0), whole.cross.sum(axis=0))
    model = nominal.model.with_coefficients(nominal.model.coefficients() + least)
    return choose_standstill_behaviour(model, logs.tracks)
