"""Viscous friction: torque proportional to speed."""

from residual.effects.base import Effect, EffectTrait, build_local_law, dissipates_with_speed

EFFECT = Effect(
    name="viscous",
    noun="viscous friction",
    sentence="resistance proportional to the joint's speed (grease, seals)",
    equation="tau = coefficient * qd",
    parameters={"coefficient": "N m s/rad"},
    **build_local_law("qd", joint=("damping",)),
    traits=EffectTrait.PARAMETER
    | EffectTrait.NOT_NEGATIVE
    | EffectTrait.GROUPABLE
    | EffectTrait.MOTOR
    | EffectTrait.FRICTION,
    drive_order=1,
    carries="speed",
    possible=dissipates_with_speed,
    in_any_arm=lambda span, j: ((),),
)
