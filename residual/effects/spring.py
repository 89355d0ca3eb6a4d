"""A spring on the joint: hose package, cable, or a coil balancer."""

import numpy as np

from residual.effects.base import Effect, EffectTrait, against_position, build_local_law

MOST = 3.0  # times the joint's torque: limit of a spring that carries the arm


def _values(theta, shape, robot):
    stiffness, constant = theta
    rest = -constant / stiffness if stiffness else 0.0
    return np.array([stiffness, rest])


def _unit_directions(states, joints):
    """Rest in the middle of the motion, where it is least visible."""
    q = np.concatenate([s.q[:, joints[0]] for s in states])
    return [np.array([1.0, -q.mean()])]


def _possible(theta, shape, limits):
    """It pulls back, with a rest position near the range of the joint.

    With a rest position turns away it is a constant torque, not a spring.
    """
    stiffness, constant = theta
    width = min(limits.upper - limits.lower, 2 * np.pi)
    if stiffness <= 0 or stiffness * width > MOST * limits.torque:
        return False
    low, high = max(limits.lower, -np.pi), min(limits.upper, np.pi)
    return bool(low - width < -constant / stiffness < high + width)


EFFECT = Effect(
    name="spring",
    noun="a spring",
    sentence="a torque proportional to position, as from a spring or hose package",
    equation="tau = stiffness * (q - rest)",
    parameters={"stiffness": "N m/rad", "rest": "rad"},
    **build_local_law("q", "1", joint=("stiffness", "constant")),
    values=_values,
    from_values=lambda values, robot: (values[0] * np.array([1.0, -values[1]]), ()),
    unit_directions=_unit_directions,
    family="static",
    traits=EffectTrait.ONE_VARIABLE,
    variable=against_position,
    possible=_possible,
)
