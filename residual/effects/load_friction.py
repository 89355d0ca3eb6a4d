"""Friction that grows with the load the gear carries (Bittencourt et al. 2010)."""

import numpy as np

from residual.effects.base import Effect, Trait, against_load, formula, local

EFFECT = Effect(
    name="load_friction",
    noun="friction that grows with load",
    sentence="friction that grows with the torque that the gear carries",
    equation="tau = coefficient * |rigid-body torque| * sgn(qd)",
    parameters={"coefficient": "1"},
    columns=local(lambda s, j, shape: [np.abs(s.rigid[:, j]) * s.sign[:, j]]),
    traits=Trait.USES_MODEL | Trait.NOT_NEGATIVE | Trait.FRICTION,
    # A load presses teeth and bearings together; none of them runs easier for it.
    variable=against_load,
    possible=lambda theta, shape, limits: bool(0 < theta[0] < 1),
    in_any_arm=lambda span, j: ((),),
    portable=formula("a[0] * fabs(rigid) * sign"),
)
