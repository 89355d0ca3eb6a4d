"""A gravity balancer: counterweight, or the first harmonic of a gas spring."""

import numpy as np

from residual.effects.base import Effect, against_position, local


def _feature(state, j, shape):
    q = state.q[:, j]
    return [np.sin(q), np.cos(q)]


EFFECT = Effect(
    name="balancer",
    noun="a balancer",
    sentence="a torque that follows sin and cos of position, as from a counterbalance",
    parameters={"sin": "N m", "cos": "N m"},
    columns=local(_feature),
    family="static",
    variable=against_position,
)
