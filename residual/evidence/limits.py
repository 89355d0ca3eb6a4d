"""What the arm can do where an effect sits, as its `possible` wants to know it."""

import numpy as np

from residual.effects.base import Limits
from residual.evidence.design import Design, Group
from residual.evidence.fit import Fit
from residual.model.term import with_slots
from residual.recording import Array
from residual.robot.dynamics import reach

UNKNOWN = 2.0  # times the largest logged torque, where no limit is given
BODY = 10  # inertial parameters of a link


def possible(design: Design, fitted: Fit, group: Group) -> bool:
    """Whether an arm can have an effect as it came out of a fit.

    Of an effect on several joints at once every part is asked later, alone.
    """
    if group.parts:
        return True
    limits = limits_of(design, fitted, group)
    return group.effect.possible(fitted.of(group), group.shape, limits)


def limits_of(design: Design, fitted: Fit, group: Group) -> Limits:
    """Return what the arm can do at the joints of a group.

    Args:
        fitted: The fit that the group is, or would be, a member of.
    """
    robot = design.model.robot
    on = list(group.joints) or list(range(design.dof))
    return Limits(
        torque=float(_torque(design)[on].max()),
        lower=float(robot.lower[on].min()),
        upper=float(robot.upper[on].max()),
        speed=float(design.speed[on].max()),
        weight=float(sum(body.mass for body in robot.model.inertias)),
        reach=reach(robot.model),
        had=_had(design, fitted, group),
    )


def _torque(design: Design) -> Array:
    """Largest torque of each joint [N m]; what was logged shows a limit wrong."""
    seen, limit = design.peak, design.model.robot.torque_limit
    known = np.isfinite(limit) & (limit > 0)
    return np.where(known, np.maximum(limit, seen), UNKNOWN * seen)


def _had(design: Design, fitted: Fit, group: Group) -> Array:
    """What the model has of the effect, as the fit moved it. Shape (k,)."""
    model, count = design.model, len(design.nominal)
    now = model.coefficients() + fitted.theta[:count]
    if group.effect.carries == "body":
        end = BODY * design.dof
        return now[end - BODY : end]
    out = np.zeros(len(group.ids))
    for term, own in with_slots(model.terms, len(model.inertial)):
        same = term.effect.name == group.effect.name and term.joints == group.joints
        if same and term.shape == group.shape:
            out = out + now[own]
    return out
