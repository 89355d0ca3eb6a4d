"""Friction that grows with the load the gear carries (Bittencourt et al. 2010)."""

import numpy as np

from residual.effects.base import Effect, against_load, formula, local


def _feature(state, j, shape):
    return [np.abs(state.rigid[:, j]) * state.sign[:, j]]


EFFECT = Effect(
    name="load_friction",
    noun="friction that grows with load",
    sentence="friction that grows with the torque that the gear carries",
    equation="tau = coefficient * |rigid-body torque| * sgn(qd)",
    parameters={"coefficient": "1"},
    columns=local(_feature),
    uses_model=True,
    # A load presses teeth and bearings together; none of them runs easier for it.
    not_negative=True,
    variable=against_load,
    possible=lambda theta, shape, limits: bool(0 < theta[0] < 1),
    brakes=True,
    in_any_arm=lambda span, j: ((),),
    portable=formula("a[0] * fabs(rigid) * sign"),
)
