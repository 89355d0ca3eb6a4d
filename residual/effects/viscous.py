"""Viscous friction: torque proportional to speed."""

from residual.effects.base import Effect, Trait, dissipates_with_speed, formula, local

EFFECT = Effect(
    name="viscous",
    noun="viscous friction",
    sentence="resistance proportional to the joint's speed (grease, seals)",
    equation="tau = coefficient * qd",
    parameters={"coefficient": "N m s/rad"},
    columns=local(lambda state, j, shape: [state.qd[:, j]]),
    traits=Trait.PARAMETER | Trait.NOT_NEGATIVE | Trait.GROUPABLE | Trait.FRICTION,
    drive_order=1,
    carries="speed",
    possible=dissipates_with_speed,
    in_any_arm=lambda span, j: ((),),
    portable=formula("a[0] * qd", joint=("damping",)),
)
