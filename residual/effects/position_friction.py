"""Friction whose level varies with the joint's position (worn or eccentric gear)."""

import numpy as np

from residual.effects.base import (
    Effect,
    Trait,
    against_position,
    formula,
    local,
    wave,
    within_torque,
)

EFFECT = Effect(
    name="position_friction",
    noun="friction that varies with position",
    sentence="dry friction whose size varies with the joint's position",
    equation="tau = (cos * cos(q) + sin * sin(q)) * sgn(qd)",
    traits=Trait.NEEDS_TURN | Trait.FRICTION,
    parameters={"cos": "N m", "sin": "N m"},
    columns=local(
        lambda s, j, shape: [
            s.sign[:, j] * wave(s.q[:, j]) for wave in (np.cos, np.sin)
        ]
    ),
    inexact=0.2,
    variable=against_position,
    possible=within_torque,
    in_any_arm=lambda span, j: ((),),
    portable=formula("sign * (a[0] * cos(q) + a[1] * sin(q))"),
    display=wave(1, 0, "N m"),
)
