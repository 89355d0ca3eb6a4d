"""A gravity balancer: counterweight, or the first harmonic of a gas spring."""

import numpy as np

from residual.effects.base import (
    Effect,
    EffectTrait,
    against_position,
    build_formula_law,
    build_joint_columns,
    describe_wave,
)

MOST = 3.0  # times the joint's torque


EFFECT = Effect(
    name="balancer",
    noun="a balancer",
    sentence="a torque that follows sin and cos of position, as from a counterbalance",
    equation="tau = sin * sin(q) + cos * cos(q)",
    traits=EffectTrait.NEEDS_TURN | EffectTrait.ONE_VARIABLE,
    parameters={"sin": "N m", "cos": "N m"},
    columns=build_joint_columns(
        lambda state, j, shape: [np.sin(state.q[:, j]), np.cos(state.q[:, j])]
    ),
    family="static",
    inexact=0.1,
    variable=against_position,
    # It carries what the drive need not, so it may exceed the drive's own torque.
    possible=lambda theta, shape, limits: bool(np.hypot(*theta) < MOST * limits.torque),
    portable=build_formula_law("a[0] * sin(q) + a[1] * cos(q)"),
    display=describe_wave(0, 1, "N m"),
)
