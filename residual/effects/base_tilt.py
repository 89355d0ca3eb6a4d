"""A base that does not stand as the model says: gravity comes from elsewhere.

To first order |g| (tilt_x, tilt_y, 0) is added to gravity in the base frame.
"""

import numpy as np

from residual.effects.base import Effect, Portable, model_of
from residual.robot.dynamics import gravity_torque

MOST = 1.2  # rad; an arm on a wall is declared as one


def _columns(state, joints, shape):
    model = model_of(state)
    size = np.linalg.norm(model.gravity.linear)
    pushes = size * np.eye(3)[:2]
    return np.stack([gravity_torque(model, state.q, g) for g in pushes], axis=2)


def _gravity(theta, robot):
    return np.linalg.norm(robot.model.gravity.linear) * np.array([*theta, 0.0])


EFFECT = Effect(
    name="base_tilt",
    noun="a tilted base",
    sentence="gravity from another direction, as on a base that does not stand upright",
    equation="tau = gravity torque of |g| * (tilt_x, tilt_y, 0), axes of the base",
    parameters={"tilt_x": "rad", "tilt_y": "rad"},
    columns=_columns,
    scope="global",
    uses_model=True,
    # Two degrees: more is seen with the eye.
    prior_sd=lambda robot: np.full(2, np.deg2rad(2.0)),
    variable=None,
    possible=lambda theta, shape, limits: bool(np.hypot(*theta) < MOST),
    portable=Portable(gravity=_gravity),
    frame="about the axes of the base",
)
