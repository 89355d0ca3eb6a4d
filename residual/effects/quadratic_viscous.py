"""Friction that grows with the square of speed (churning oil)."""

import numpy as np

from residual.effects.base import Effect, local


def _feature(state, j, shape):
    return [state.qd[:, j] * np.abs(state.qd[:, j])]


EFFECT = Effect(
    name="quadratic_viscous",
    noun="friction that grows with the square of speed",
    sentence="resistance that grows with the square of speed (churning grease)",
    parameters={"coefficient": "N m s^2/rad^2"},
    columns=local(_feature),
    groupable=True,
)
