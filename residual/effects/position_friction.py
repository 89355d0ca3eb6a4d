"""Friction whose level varies with the joint's position (worn or eccentric gear)."""

import numpy as np

from residual.effects.base import (
    Effect,
    EffectTrait,
    against_position,
    build_formula_law,
    build_joint_columns,
    describe_wave,
    stays_within_torque,
)

EFFECT = Effect(
    name="position_friction",
    noun="friction that varies with position",
    sentence="dry friction whose size varies with the joint's position",
    equation="tau = (cos * cos(q) + sin * sin(q)) * sgn(qd)",
    traits=EffectTrait.NEEDS_TURN | EffectTrait.FRICTION,
    parameters={"cos": "N m", "sin": "N m"},
    columns=build_joint_columns(
        lambda s, j, shape: [
            s.sign[:, j] * wave(s.q[:, j]) for wave in (np.cos, np.sin)
        ]
    ),
    inexact=0.2,
    variable=against_position,
    possible=stays_within_torque,
    in_any_arm=lambda span, j: ((),),
    portable=build_formula_law("sign * (a[0] * cos(q) + a[1] * sin(q))"),
    display=describe_wave(1, 0, "N m"),
)
