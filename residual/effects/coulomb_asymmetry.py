"""Coulomb friction that differs between the two directions of motion."""

from residual.effects.base import Effect, EffectTrait, build_local_law, stays_within_torque

EFFECT = Effect(
    name="coulomb_asymmetry",
    noun="Coulomb friction that differs by direction",
    sentence="dry friction that is stronger in one direction than in the other",
    equation=("tau = level * |sgn(qd)|: the same in both directions of motion, zero at rest"),
    parameters={"level": "N m"},
    **build_local_law("fabs(sign)"),
    far_fetched=0.5,
    family="static",
    traits=EffectTrait.GROUPABLE | EffectTrait.FRICTION,
    possible=stays_within_torque,
)
