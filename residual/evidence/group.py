"""One candidate finding: columns that stand or fall together."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.effects.base import Effect, Joints, Shape
from residual.recording import Array


@dataclass(frozen=True, eq=False, slots=True)
class Group:
    """Columns that stand or fall together: one candidate finding.

    Attributes:
        effect, joints, shape: What they are; joints from 0.
        ids: Their column numbers. Shape (k,).
        precision: Prior precision of their coefficients. Shape (k, k).
        log_det: Log determinant of the precision.
        parts: For one effect on all joints at once, the groups of the single joints.
        fellows: How many came together with this one in such a group.
        label: Name of the candidate; the effect's own where empty.
    """

    effect: Effect
    joints: Joints
    shape: Shape
    ids: Array
    precision: Array
    log_det: float
    parts: tuple["Group", ...] = ()
    fellows: int = 1
    label: str = ""

    @property
    def key(self) -> tuple:
        """Identity apart from a searched shape: one candidate finding per key."""
        fixed = self.shape if self.effect.refine is None else ()
        return (self.label or self.effect.name, self.joints, fixed)


def sound(precision: Array) -> tuple[Array, float]:
    """A precision that has an inverse, and its log determinant. (k, k) as given."""
    scale = np.sqrt(np.maximum(np.diag(precision), 1e-12))
    precision = precision + 1e-6 * np.diag(scale**2)
    log_det = 2 * np.log(scale).sum()
    log_det += np.linalg.slogdet(precision / np.outer(scale, scale))[1]
    return precision, float(log_det)


def union(parts: Sequence[Group], label: str = "") -> Group:
    """One candidate of several groups, such as an effect on all joints."""
    parts = [replace(g, fellows=len(parts)) for g in parts]
    sizes = [len(g.ids) for g in parts]
    precision = np.zeros((sum(sizes), sum(sizes)))
    start = 0
    for g, k in zip(parts, sizes, strict=True):
        precision[start : start + k, start : start + k] = g.precision
        start += k
    return Group(
        effect=parts[0].effect,
        joints=tuple(sorted({j for g in parts for j in g.joints})),
        shape=parts[0].shape,
        ids=np.concatenate([g.ids for g in parts]),
        precision=precision,
        log_det=sum(g.log_det for g in parts),
        parts=tuple(parts),
        label=label,
    )
