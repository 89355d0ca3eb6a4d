"""A constant force on the flange, in the base frame: a hose, a tool that presses."""

import numpy as np

from residual.effects.base import Effect, ExportedLaw


def _columns(state, joints, shape):
    """The drives hold against the force: -J' f."""
    from residual.robot.dynamics import compute_flange_jacobian

    linear = compute_flange_jacobian(state.robot.model, state.q)[:, :3]
    return -linear.transpose(0, 2, 1)


EFFECT = Effect(
    name="tool_force",
    noun="a constant force at the tool",
    sentence="a constant force on the flange, as from a hose or a tool that presses",
    equation="tau = -J(q)^T * (x, y, z), axes of the base",
    parameters={"x": "N", "y": "N", "z": "N"},
    columns=_columns,
    scope="global",
    # 3 % of the arm's weight.
    prior_sd=lambda robot: np.full(
        3, 0.03 * 9.81 * sum(body.mass for body in robot.model.inertias)
    ),
    variable=None,
    possible=lambda theta, shape, limits: bool(np.linalg.norm(theta) < 9.81 * limits.weight),
    portable=ExportedLaw(force=np.array),
    frame="in the axes of the base",
)
