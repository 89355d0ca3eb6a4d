"""Viscous friction: torque proportional to speed."""

from residual.effects.base import Effect, local


def _feature(state, j, shape):
    return [state.qd[:, j]]


EFFECT = Effect(
    name="viscous",
    sentence="resistance proportional to the joint's speed (grease, seals)",
    parameters={"coefficient": "N m s/rad"},
    columns=local(_feature),
    is_parameter=True,
    groupable=True,
)
