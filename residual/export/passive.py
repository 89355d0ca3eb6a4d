"""What the terms of a model are as properties of a simulated joint."""

from collections.abc import Collection

import numpy as np

from residual.export.exported import Split, Whole, body_of, split
from residual.model.model import LEAST_SPEED, Model
from residual.model.term import Term
from residual.recording import Array
from residual.signals.direction import SMOOTH

FULL = 20.0  # tanh of it is one, to the last bit
NOT_NEGATIVE = ("damping", "quadratic_damping", "friction", "armature", "stiffness")


def split_passive(
    whole: Whole, target: str, can: Collection[str], gravity: bool = False
) -> Split:
    """Part what the joints and bodies of a target can have from the rest."""
    total = properties(body_of(whole))

    def refuse(term: Term) -> str:
        said = term.effect.portable
        if said.bodies or (gravity and said.gravity):
            return ""
        if not said.joint or not set(said.joint) <= set(can):
            return f"{target} has no place for it"
        (joint,) = term.joints
        for name in said.joint:
            if name in NOT_NEGATIVE and total[name][joint] < 0:
                return f"{target} takes no negative {name}"
        # A constant torque is a spring that is at rest elsewhere.
        lone = "constant" in said.joint and not total["stiffness"][joint] > 0
        return f"{target} has no constant torque on a joint" if lone else ""

    return split(whole, refuse, f"{target} has no tables")


def properties(model: Model) -> dict[str, Array]:
    """Return the properties of the joints, those of all terms added. (dof,) each."""
    names = (*NOT_NEGATIVE, "constant")
    out = {name: np.zeros(model.robot.dof) for name in names}
    for term in model.terms:
        for name, value in zip(term.effect.portable.joint, term.theta, strict=False):
            out[name][list(term.joints)] += value
    return out


def saturated_speed(model: Model) -> Array:
    """Return the speeds above which its dry friction has its full value. (dof,)."""
    known = model.speed_floor
    floor = np.full(model.robot.dof, LEAST_SPEED) if known is None else known
    shapes = model.standstill or (SMOOTH,) * model.robot.dof
    times = [max(s.reach, FULL * s.size if s.kind == "smooth" else 0) for s in shapes]
    return floor * np.array(times)
