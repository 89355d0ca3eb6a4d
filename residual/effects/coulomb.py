"""Coulomb friction: torque of constant size against the direction of motion."""

from residual.effects.base import Effect, EffectTrait, build_local_law, dissipates

EFFECT = Effect(
    name="coulomb",
    noun="Coulomb friction",
    sentence="dry friction of constant size against the direction of motion",
    equation="tau = level * sgn(qd)",
    parameters={"level": "N m"},
    **build_local_law("sign", joint=("friction",)),
    traits=EffectTrait.PARAMETER
    | EffectTrait.NOT_NEGATIVE
    | EffectTrait.GROUPABLE
    | EffectTrait.FRICTION,
    drive_order=2,
    possible=dissipates,
    in_any_arm=lambda span, j: ((),),
)
