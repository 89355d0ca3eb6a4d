"""Coulomb friction: torque of constant size against the direction of motion."""

from residual.effects.base import Effect, Trait, dissipates, formula, local

EFFECT = Effect(
    name="coulomb",
    noun="Coulomb friction",
    sentence="dry friction of constant size against the direction of motion",
    equation="tau = level * sgn(qd)",
    parameters={"level": "N m"},
    columns=local(lambda state, j, shape: [state.sign[:, j]]),
    traits=Trait.PARAMETER | Trait.NOT_NEGATIVE | Trait.GROUPABLE | Trait.FRICTION,
    drive_order=2,
    possible=dissipates,
    in_any_arm=lambda span, j: ((),),
    portable=formula("a[0] * sign", joint=("friction",)),
)
