"""Friction that grows with the square of speed (churning oil)."""

from residual.effects.base import Effect, EffectTrait, build_local_law, dissipates_with_speed

EFFECT = Effect(
    name="quadratic_viscous",
    noun="friction that grows with the square of speed",
    sentence="resistance that grows with the square of speed (churning grease)",
    equation="tau = coefficient * qd * |qd|",
    parameters={"coefficient": "N m s^2/rad^2"},
    **build_local_law("qd * fabs(qd)", joint=("quadratic_damping",)),
    traits=EffectTrait.GROUPABLE | EffectTrait.FRICTION,
    possible=lambda theta, shape, limits: dissipates_with_speed(
        theta * limits.speed, shape, limits
    ),
    in_any_arm=lambda span, j: ((),),
)
