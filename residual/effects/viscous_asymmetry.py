"""Viscous friction that differs between the two directions of motion."""

from residual.effects.base import Effect, EffectTrait, build_local_law, stays_within_torque

EFFECT = Effect(
    name="viscous_asymmetry",
    noun="viscous friction that differs by direction",
    sentence="viscous friction that is stronger in one direction than in the other",
    equation="tau = coefficient * |qd|",
    parameters={"coefficient": "N m s/rad"},
    **build_local_law("fabs(qd)"),
    possible=lambda theta, shape, limits: stays_within_torque(theta * limits.speed, shape, limits),
    traits=EffectTrait.FRICTION,
    in_any_arm=lambda span, j: ((),),
)
