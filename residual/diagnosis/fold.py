"""What of the findings is no more than any used arm has: said in one line, not listed.

A diagnosis finds small true things beside the large one: a ripple of the gear, friction
that is another when the arm is cold. They are no reason to look.
"""

from collections.abc import Sequence

import numpy as np

from residual.diagnosis.findings import Named

USUAL = 0.03  # of the joint's torque rms: what gears and drives have anyway
HALF, FEW = 0.5, 3  # of the joints
BESIDE = 0.1  # of the largest torque of a finding


def folded(
    named: Sequence[Named], dof: int
) -> tuple[tuple[Named, ...], tuple[Named, ...]]:
    """Part the findings into those to be listed and those to be folded.

    Folded is friction or ripple of a size that the joints have anyway, beside something
    much larger, where half of the joints have such: one alone is a finding.

    Returns:
        What is listed, and what is folded, in the same order.
    """
    if not named:
        return tuple(named), ()
    largest = max(f.torque.max() for f in named)
    small = [f for f in named if _is_usual(f, BESIDE * largest)]
    if len({j for f in small for j in f.joints}) < max(HALF * dof, FEW):
        small = []
    return tuple(f for f in named if f not in small), tuple(small)


def _is_usual(found: Named, least: float) -> bool:
    effect = found.effect
    if not (effect.brakes or effect.repeats) or effect.scope != "local":
        return False
    return bool(np.all(found.torque < min(USUAL, least)))
