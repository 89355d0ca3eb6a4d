"""A constant force on the flange, in the base frame: a hose, a tool that presses."""

import numpy as np

from residual.effects.base import Effect, Portable
from residual.robot.dynamics import flange_jacobian


def _columns(state, joints, shape):
    """The drives hold against what the force does: -J' f."""
    linear = flange_jacobian(state.robot.model, state.q)[:, :3]
    return -linear.transpose(0, 2, 1)


def _prior_sd(robot):
    """A push of 3 % of the arm's weight, as the payload that it may carry."""
    mass = sum(body.mass for body in robot.model.inertias)
    return np.full(3, 0.03 * 9.81 * mass)


def _possible(theta, shape, limits):
    """No stronger than the arm is heavy."""
    return bool(np.linalg.norm(theta) < 9.81 * limits.weight)


EFFECT = Effect(
    name="tool_force",
    noun="a constant force at the tool",
    sentence="a constant force on the flange, as from a hose or a tool that presses",
    equation="tau = -J(q)^T * (x, y, z), axes of the base",
    parameters={"x": "N", "y": "N", "z": "N"},
    columns=_columns,
    scope="global",
    prior_sd=_prior_sd,
    variable=None,
    possible=_possible,
    portable=Portable(force=np.array),
    frame="in the axes of the base",
)
