"""One candidate finding: columns that stand or fall together."""

from dataclasses import dataclass

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
