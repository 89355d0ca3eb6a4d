"""Viscous friction: torque proportional to speed."""

from residual.effects.base import Effect, dissipates_with_speed, formula, local

EFFECT = Effect(
    name="viscous",
    noun="viscous friction",
    sentence="resistance proportional to the joint's speed (grease, seals)",
    equation="tau = coefficient * qd",
    parameters={"coefficient": "N m s/rad"},
    columns=local(lambda state, j, shape: [state.qd[:, j]]),
    is_parameter=True,
    usual_in_every_drive=1,
    carries="speed",
    not_negative=True,
    groupable=True,
    possible=dissipates_with_speed,
    brakes=True,
    in_any_arm=lambda span, j: ((),),
    portable=formula("a[0] * qd", joint=("damping",)),
)
