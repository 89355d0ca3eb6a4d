"""A gravity balancer: counterweight, or the first harmonic of a gas spring."""

import numpy as np

from residual.effects.base import Effect, Trait, against_position, formula, local, wave

MOST = 3.0  # times the joint's torque


EFFECT = Effect(
    name="balancer",
    noun="a balancer",
    sentence="a torque that follows sin and cos of position, as from a counterbalance",
    equation="tau = sin * sin(q) + cos * cos(q)",
    traits=Trait.NEEDS_TURN | Trait.ONE_VARIABLE,
    parameters={"sin": "N m", "cos": "N m"},
    columns=local(
        lambda state, j, shape: [np.sin(state.q[:, j]), np.cos(state.q[:, j])]
    ),
    family="static",
    inexact=0.1,
    variable=against_position,
    # It carries what the drive need not, so it may exceed the drive's own torque.
    possible=lambda theta, shape, limits: bool(np.hypot(*theta) < MOST * limits.torque),
    portable=formula("a[0] * sin(q) + a[1] * cos(q)"),
    display=wave(0, 1, "N m"),
)
