"""Coulomb friction: torque of constant size against the direction of motion."""

from residual.effects.base import Effect, local


def _feature(state, j, shape):
    return [state.sign[:, j]]


EFFECT = Effect(
    name="coulomb",
    sentence="dry friction of constant size against the direction of motion",
    parameters={"level": "N m"},
    columns=local(_feature),
    is_parameter=True,
    groupable=True,
)
