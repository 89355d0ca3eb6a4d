"""Coulomb friction: torque of constant size against the direction of motion."""

from residual.effects.base import Effect, dissipates, formula, local

EFFECT = Effect(
    name="coulomb",
    noun="Coulomb friction",
    sentence="dry friction of constant size against the direction of motion",
    equation="tau = level * sgn(qd)",
    parameters={"level": "N m"},
    columns=local(lambda state, j, shape: [state.sign[:, j]]),
    is_parameter=True,
    usual_in_every_drive=2,
    not_negative=True,
    groupable=True,
    possible=dissipates,
    brakes=True,
    in_any_arm=lambda span, j: ((),),
    portable=formula("a[0] * sign", joint=("friction",)),
)
