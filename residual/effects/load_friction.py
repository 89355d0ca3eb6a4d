"""Friction that grows with the load the gear carries (Bittencourt et al. 2010)."""

import numpy as np

from residual.effects.base import (
    Effect,
    EffectTrait,
    against_load,
    build_formula_law,
    build_joint_columns,
)

EFFECT = Effect(
    name="load_friction",
    noun="friction that grows with load",
    sentence="friction that grows with the torque that the gear carries",
    equation="tau = coefficient * |rigid-body torque| * sgn(qd)",
    parameters={"coefficient": "1"},
    columns=build_joint_columns(
        lambda s, j, shape: [np.abs(s.rigid[:, j]) * s.sign[:, j]]
    ),
    traits=EffectTrait.USES_MODEL | EffectTrait.NOT_NEGATIVE | EffectTrait.FRICTION,
    # A load presses teeth and bearings together; none of them runs easier for it.
    variable=against_load,
    possible=lambda theta, shape, limits: bool(0 < theta[0] < 1),
    in_any_arm=lambda span, j: ((),),
    portable=build_formula_law("a[0] * fabs(rigid) * sign"),
)
