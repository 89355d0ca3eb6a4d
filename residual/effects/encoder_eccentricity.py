"""An encoder whose disc is off centre: an error once per turn, true minus read."""

import numpy as np

from residual.effects.base import Effect, EffectTrait, ExportedLaw, describe_wave
from residual.effects.sensitivity import compute_shift_torque

MOST = 0.2  # rad
SHIFT = (
    "a[0] * cos(q) + a[1] * sin(q)",
    "(a[1] * cos(q) - a[0] * sin(q)) * qd",
    "(a[1] * cos(q) - a[0] * sin(q)) * qdd - (a[0] * cos(q) + a[1] * sin(q)) * qd * qd",
)


def _columns(state, joints, shape):
    (j,) = joints
    q, qd, qdd = state.q[:, j], state.qd[:, j], state.qdd[:, j]
    cos, sin = np.cos(q), np.sin(q)
    shifts = (
        (cos, (-sin * qd, -cos * qd**2 - sin * qdd)),
        (sin, (cos * qd, -sin * qd**2 + cos * qdd)),
    )
    out = np.stack([compute_shift_torque(state, j, *shift) for shift in shifts], axis=2)
    if state.drive is not None:  # it is shifted with the joint
        viscous, rotor = state.drive[:, j]
        for k, (_, rates) in enumerate(shifts):
            out[:, j, k] += viscous * rates[0] + rotor * rates[1]
    return out


EFFECT = Effect(
    name="encoder_eccentricity",
    noun="encoder eccentricity",
    sentence="an encoder whose error repeats once per turn",
    equation=(
        "d tau = dtau/dq_j x + dtau/dqd_j x' + dtau/dqdd_j x'', where x = cos * "
        "cos(q_j) + sin * sin(q_j)"
    ),
    traits=EffectTrait.NEEDS_TURN | EffectTrait.USES_MODEL,
    parameters={"cos": "rad", "sin": "rad"},
    columns=_columns,
    scope="link",
    prior_sd=lambda robot: np.full(2, np.deg2rad(0.7)),
    family="geometry",
    variable=None,
    possible=lambda theta, shape, limits: bool(np.hypot(*theta) < MOST),
    portable=ExportedLaw(shift=SHIFT),
    display=describe_wave(1, 0, "rad"),
)
