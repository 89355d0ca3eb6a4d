"""A gear that twists under its load (Spong 1987): the link lags behind the motor.

The encoder sits on the motor, so the link is at the reading less load over stiffness.
"""

import numpy as np

from residual.effects.base import Effect, EffectTrait, ExportedLaw, against_load
from residual.effects.sensitivity import (
    compute_shift_torque,
    compute_time_derivatives,
    filter_before_differentiation,
)

FUTURE = "its filter looks ahead in time"
SOFT, HARD = 3e2, 1e7  # N m/rad: no gear of an arm is stiffer


def _columns(state, joints, shape):
    (j,) = joints
    lag = -filter_before_differentiation(state, state.rigid[:, j])
    return compute_shift_torque(state, j, lag, compute_time_derivatives(state, lag))[:, :, None]


EFFECT = Effect(
    name="elasticity",
    noun="joint elasticity",
    sentence="a gear that twists under its load",
    equation=(
        "d tau = dtau/dq_j x + dtau/dqd_j x' + dtau/dqdd_j x'', where x = -load / "
        "stiffness, below 5 Hz"
    ),
    parameters={"stiffness": "N m/rad"},
    columns=_columns,
    scope="link",
    values=lambda theta, shape, robot: 1 / np.where(theta == 0, 1e-12, theta),
    from_values=lambda values, robot: (1 / values, ()),
    traits=EffectTrait.USES_MODEL | EffectTrait.MEMORY,
    # In compliance: 1e4 N m/rad is a soft gear of an arm of 100 kg.
    prior_sd=lambda robot: np.array([2e-4]),
    possible=lambda theta, shape, limits: bool(1 / HARD < theta[0] < 1 / SOFT),
    family="geometry",
    # Its column ends at 5 Hz, unlike the torque: the result is 10 to 35 % too soft.
    inexact=0.3,
    variable=against_load,
    portable=ExportedLaw(obstacle=FUTURE),
)
