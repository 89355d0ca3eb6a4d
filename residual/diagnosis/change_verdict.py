"""The verdict on two epochs: the changes, their sizes, and detectable sizes."""

from collections.abc import Iterator, Sequence

import numpy as np

from residual.check.result import LogCheck
from residual.diagnosis.detectable import find_detectable_sizes
from residual.diagnosis.epoch_outcome import EpochFit, EpochOutcome
from residual.diagnosis.findings import NamedEffect, values_jacobian
from residual.diagnosis.held_out import Proof
from residual.diagnosis.rivals import RivalSet
from residual.diagnosis.unexplained import JointRemainder, list_dependences
from residual.diagnosis.verdict import build_finding, collect_warnings, list_alternatives
from residual.evidence.fit import PossibleModel
from residual.evidence.thresholds import THRESHOLDS
from residual.model.model import pair_coefficient_slices
from residual.quantity import convert_to_plain_values
from residual.verdict.diagnosis import name_frames, replace_by_model_values
from residual.verdict.result import (
    STILL,
    Change,
    Detectable,
    Drift,
    ErrorTables,
    Unexplained,
    Verdict,
)


def build_change_verdict(
    proof: Proof,
    named: Sequence[NamedEffect],
    suspected: Sequence[NamedEffect],
    augmented: PossibleModel,
    remains: Sequence[JointRemainder],
    rivals: Sequence[RivalSet],
    epochs: tuple[EpochFit, EpochFit],
    tables: ErrorTables,
    check: LogCheck | None,
    notes: Sequence[str],
    doubts: Sequence[str],
) -> Verdict:
    """Return the verdict, of plain values.

    Args:
        named: The changes, most torque first.
        suspected: Less certain or refuted changes, in no model.
        rivals: Sets that the logs cannot separate from the named one.
        epochs: Separate fits of both epochs.
        notes: Warnings on the logs, which come first.
        doubts: Why the named changes do not explain the second epoch.
    """
    outcome, span = proof.outcome, proof.outcome.logs.span
    still = not any(t.moving.any() for t in epochs[1].logs.tracks)
    unlikely = outcome.impossible or augmented
    contradictions = (STILL,) if still else unlikely.doubts
    doubtful = outcome.adequacy.doubted or contradictions
    least = find_detectable_sizes(outcome.selection.search, outcome.fit)
    drift = outcome.epochs.drift
    listing = [build_finding(f, i, proof, span) for i, f in enumerate(named, 1)]
    return Verdict(
        robot=outcome.logs.robot.name,
        declared=tuple(outcome.nominal.names),
        verdict="effects" if named else "unknown" if doubtful else "none",
        effects=tuple(replace_by_model_values(f, augmented) for f in listing),
        minimum_detectable=(*least, Detectable("drift", (), 2 * drift.deviation, "1")),
        unexplained=_unexplained(outcome, remains),
        error=tables,
        nominal_scale=None,
        next_experiment=None,
        warnings=(
            *notes,
            *collect_warnings(proof, tables.same_run),
            *(
                f"joint {j + 1} hardly moves in one of the epochs and is not compared"
                for j, own in enumerate(outcome.epochs.design.epochs)
                if not own.compared
            ),
            *doubts,
        ),
        log_check=check,
        contradictions=contradictions,
        drift=_describe_drift(outcome) if outcome.drift else None,
        bodies=unlikely.correction,
        frames=name_frames(outcome.logs.robot),
        changes=tuple(_compare_values(*epochs, outcome)),
        alternatives=list_alternatives(rivals),
        suspected=tuple(build_finding(f, i, proof, span) for i, f in enumerate(suspected, 1)),
    )


def _unexplained(outcome: EpochOutcome, remains: Sequence[JointRemainder]) -> Unexplained:
    left, design = outcome.adequacy, outcome.design
    power = design.rows * design.rms**2
    shares = (left.structured_share, left.noise)
    both = [float(np.sqrt(power @ x**2 / power.sum())) for x in shares]
    return Unexplained(
        joints=tuple(j + 1 for j in left.doubted),
        fraction=convert_to_plain_values(both[0]),
        noise_floor=convert_to_plain_values(both[1]),
        depends_on=list_dependences(remains),
        kind=None,
        per_joint=tuple(convert_to_plain_values(left.structured_share)),
        noise_model="first epoch",
    )


def _describe_drift(outcome: EpochOutcome) -> Drift:
    factor, found = outcome.drift, outcome.epochs.drift
    same = np.nan_to_num(found.moved) * np.sign(factor)
    joints = np.flatnonzero(same > THRESHOLDS.moved_share * abs(factor))
    return Drift(
        factor=convert_to_plain_values(1 + factor),
        std=convert_to_plain_values(found.deviation),
        joints=tuple(int(j) + 1 for j in joints),
        clock="order" if outcome.logs.clock is None else "recording time",
    )


def _compare_values(first: EpochFit, second: EpochFit, outcome: EpochOutcome) -> Iterator[Change]:
    """Declared values of separate fits of both epochs, with both deviations.

    Two fits may distribute the same friction differently. So a value is reported as off
    only if the comparison of both epochs agrees.
    """
    named = {(m.group.effect.name, m.group.joints) for m in outcome.named}
    robot, size = first.model.robot, len(first.model.inertial)
    spread = sum(one.joint.fitted.covariance() for one in (first, second))
    placed = pair_coefficient_slices(first.model.terms, size)
    for (term, own), now in zip(placed, second.model.terms, strict=True):
        effect = term.effect
        before, after = (effect.values(x.theta, x.shape, robot) for x in (term, now))
        slope = values_jacobian(effect, term.theta, term.shape, robot)
        sd = np.sqrt(np.diag(slope @ spread[own, own] @ slope.T))
        for i, (key, unit) in enumerate(effect.units(term.joints, robot).items()):
            gap = float(after[i] - before[i])
            sigma = abs(gap) / sd[i] if sd[i] > 0 else None
            beyond = (effect.name, term.joints) in named and sigma is not None
            beyond = beyond and sigma > THRESHOLDS.drift_deviations
            beyond = beyond and abs(gap) > THRESHOLDS.min_value_change * abs(before[i])
            yield Change(
                name=effect.name,
                joints=tuple(j + 1 for j in term.joints),
                parameter=key,
                nominal=convert_to_plain_values(float(before[i])),
                identified=convert_to_plain_values(float(after[i])),
                std=convert_to_plain_values(float(sd[i])),
                unit=unit,
                sigma=convert_to_plain_values(sigma),
                beyond=bool(beyond),
            )
