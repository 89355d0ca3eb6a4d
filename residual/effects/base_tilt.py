"""A base tilted against the model: gravity has another direction.

The tilt is an angle of rotation of up to ten degrees; beyond, an arm is mounted
otherwise than its file says (residual.check.slips). |g| times its tangent is added
to gravity in the base frame.
"""

import numpy as np

from residual.effects.base import Effect, EffectTrait, ExportedLaw
from residual.effects.sensitivity import compute_weight_torque

MOST = np.deg2rad(10.0)


def _columns(state, joints, shape):
    size = np.linalg.norm(state.robot.model.gravity.linear)
    return size * compute_weight_torque(state)


def _angles(theta, shape, robot):
    """Angles of rotation about the axes, from the fitted tangents."""
    size = np.hypot(*theta)
    return theta * (np.arctan(size) / size if size else 1.0)


def _tangents(values, robot):
    size = np.hypot(*values)
    return values * (np.tan(size) / size if size else 1.0), ()


EFFECT = Effect(
    name="base_tilt",
    noun="a tilted base",
    sentence="gravity from another direction, as on a base that does not stand upright",
    equation="tau = gravity torque of |g| tan(tilt_x, tilt_y, 0), axes of the base",
    parameters={"tilt_x": "rad", "tilt_y": "rad"},
    columns=_columns,
    scope="global",
    values=_angles,
    from_values=_tangents,
    traits=EffectTrait.USES_MODEL,
    # Two degrees: more is visible.
    prior_sd=lambda robot: np.full(2, np.deg2rad(2.0)),
    variable=None,
    possible=lambda theta, shape, limits: bool(np.hypot(*theta) < np.tan(MOST)),
    portable=ExportedLaw(
        gravity=lambda theta, robot: (
            np.linalg.norm(robot.model.gravity.linear) * np.array([*theta, 0.0])
        )
    ),
    frame="about the axes of the base",
)
