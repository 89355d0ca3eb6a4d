"""An encoder that is off by a constant angle, true minus read."""

import numpy as np

from residual.effects.base import Effect, EffectTrait, ExportedLaw
from residual.effects.sensitivity import compute_torque_derivatives

MOST = 0.5  # rad: more would be noticed


EFFECT = Effect(
    name="encoder_offset",
    noun="an encoder offset",
    sentence="an encoder that is off by a constant angle",
    equation="d tau = dtau/dq_j * angle",
    parameters={"angle": "rad"},
    columns=lambda state, joints, shape: compute_torque_derivatives(state)[0][:, :, list(joints)],
    scope="link",
    traits=EffectTrait.USES_MODEL,
    prior_sd=lambda robot: np.full(1, np.deg2rad(1.0)),
    family="geometry",
    variable=None,
    possible=lambda theta, shape, limits: bool(abs(theta[0]) < MOST),
    portable=ExportedLaw(shift=("a[0]", "0", "0")),
)
