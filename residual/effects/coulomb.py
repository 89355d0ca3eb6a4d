"""Coulomb friction: torque of constant size against the direction of motion."""

from residual.effects.base import (
    Effect,
    EffectTrait,
    build_formula_law,
    build_joint_columns,
    dissipates,
)

EFFECT = Effect(
    name="coulomb",
    noun="Coulomb friction",
    sentence="dry friction of constant size against the direction of motion",
    equation="tau = level * sgn(qd)",
    parameters={"level": "N m"},
    columns=build_joint_columns(lambda state, j, shape: [state.sign[:, j]]),
    traits=EffectTrait.PARAMETER
    | EffectTrait.NOT_NEGATIVE
    | EffectTrait.GROUPABLE
    | EffectTrait.FRICTION,
    drive_order=2,
    possible=dissipates,
    in_any_arm=lambda span, j: ((),),
    portable=build_formula_law("a[0] * sign", joint=("friction",)),
)
