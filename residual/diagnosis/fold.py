"""What of the findings is no more than any used arm has: said in one line, not listed.

A diagnosis finds small true things beside the large one: a ripple of the gear, friction
that is another when the arm is cold. They are no reason to look.
"""

from collections.abc import Sequence

from residual.diagnosis.examine import Examined
from residual.diagnosis.findings import Named

USUAL = 2.0  # times what the tables of a joint are expected to have
BESIDE = 0.1  # of the largest torque of a finding


def folded(
    examined: Examined, named: Sequence[Named]
) -> tuple[tuple[Named, ...], tuple[Named, ...]]:
    """Part the findings into those to be listed and those to be folded.

    Folded is friction or ripple of a size that the joints have anyway, beside something
    much larger.

    Args:
        examined: The diagnosis.
        named: The findings.

    Returns:
        What is listed, and what is folded, in the same order.
    """
    if not named:
        return tuple(named), ()
    largest = max(f.torque.max() for f in named)
    small = [f for f in named if _is_usual(examined, f, BESIDE * largest)]
    return tuple(f for f in named if f not in small), tuple(small)


def _is_usual(examined: Examined, found: Named, least: float) -> bool:
    design, effect = examined.task.design, found.effect
    if not (effect.brakes or effect.repeats) or effect.scope != "local":
        return False
    joints = [t.group.joints[0] for t in found.tested]
    return all(
        torque < min(USUAL * design.usual(j), least)
        for j, torque in zip(joints, found.torque, strict=True)
    )
