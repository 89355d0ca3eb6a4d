"""Constant torque: current-sensor bias, or a constant load."""

from residual.effects.base import Effect, EffectTrait, build_local_law, stays_within_torque

EFFECT = Effect(
    name="offset",
    noun="a constant torque offset",
    sentence="a constant torque, as from a biased current sensor",
    equation="tau = torque",
    parameters={"torque": "N m"},
    **build_local_law("1", joint=("constant",)),
    family="static",
    traits=EffectTrait.CONSTANT | EffectTrait.GROUPABLE,
    possible=stays_within_torque,
    in_any_arm=lambda span, j: ((),),
)
