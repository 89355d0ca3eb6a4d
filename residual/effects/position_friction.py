"""Friction whose level varies with the joint's position (worn or eccentric gear)."""

from residual.effects.base import (
    Effect,
    EffectTrait,
    against_position,
    build_local_law,
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
    **build_local_law("sign * cos(q)", "sign * sin(q)"),
    inexact=0.2,
    variable=against_position,
    possible=stays_within_torque,
    in_any_arm=lambda span, j: ((),),
    display=describe_wave(1, 0, "N m"),
)
