"""What a finding means for the robot: its size, and the torque that is missing."""

from typing import NamedTuple

import numpy as np

from flows.report.words.rows import FindingRow
from residual.diagnosis.result import Diagnosis, Finding
from residual.effects import registry
from residual.model.compare import Cloud
from residual.quantity import MISSING, fraction, known, measured, number, unit_text

_CERTAIN = (0.999, 0.99)


class Missing(NamedTuple):
    """Torque of an effect on one joint.

    Attributes:
        joint: Joint from 1.
        peak: The most of it on the logs of the fit [N m].
        share: That, of the largest torque measured there on held-out motion; None
            where that is not known.
    """

    joint: int
    peak: float
    share: float | None


def missing_torque(found: Diagnosis, row: FindingRow) -> list[Missing]:
    """Return what the torque lacks without a finding, the largest share first."""
    effect = registry().get(row.name)
    mine = [c for c in found.clouds if c.name == row.name and len(c.x)]
    if effect is not None and effect.variable is not None and row.joints:
        mine = [c for c in mine if c.joint in row.joints] or mine
    out = []
    for cloud in mine:
        peak = float(np.abs(cloud.fitted).max())
        whole = _largest(found, cloud.joint)
        out.append(Missing(cloud.joint, peak, peak / whole if whole else None))
    return sorted(out, key=lambda one: -(one.share or 0.0))


def means(found: Diagnosis, row: FindingRow) -> str:
    """Return in one sentence what a model without it gets wrong; empty if unknown."""
    lacking = missing_torque(found, row)[:2]
    if not lacking:
        return ""
    parts = [
        f"by up to {number(one.peak)} N m on joint {one.joint}"
        + (f" ({fraction(one.share)} of the largest torque there)" if one.share else "")
        for one in lacking
    ]
    return f"Without it the predicted torque is off {' and '.join(parts)}."


def size_of(finding: Finding) -> tuple[str, str]:
    """Return (parameter, value) of the first one that the logs determine.

    Of several joints the smallest and the largest value.
    """
    for key, parameter in finding.parameters.items():
        values = [v for v, _ in parameter.pairs if known(v)]
        if not parameter.determined or not values:
            continue
        name = key.replace("_", " ")
        if len(values) == 1:
            return name, measured(*parameter.pairs[0], parameter.unit)
        low, high = min(values), max(values)
        span = f"{number(low)} to {number(high)} {unit_text(parameter.unit)}"
        return name, span.strip()
    return "", MISSING


def sure(probability: float | None) -> str:
    """Return a probability as people weigh it: never one, since no data give that."""
    if not known(probability):
        return MISSING
    for limit in _CERTAIN:
        if probability > limit:
            return f"p > {limit:g}"
    return f"p = {probability:.2f}" if probability >= 0.01 else "p < 0.01"


def explained_share(cloud: Cloud) -> float | None:
    """Return the part of a residual's mean square that an effect explains."""
    whole = float(np.mean(cloud.residual**2))
    if not whole:
        return None
    left = float(np.mean((cloud.residual - cloud.fitted) ** 2))
    return max(0.0, 1 - left / whole)


def _largest(found: Diagnosis, joint: int) -> float | None:
    sizes = [
        float(np.abs(p.tau[:, joint - 1]).max())
        for p in found.proofs
        if len(p.t) and joint <= p.tau.shape[1]
    ]
    return max(sizes, default=None)
