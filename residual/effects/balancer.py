"""A gravity balancer: counterweight, or the first harmonic of a gas spring."""

import numpy as np

from residual.effects.base import (
    Effect,
    EffectTrait,
    against_position,
    build_local_law,
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
    **build_local_law("sin(q)", "cos(q)"),
    family="static",
    inexact=0.1,
    variable=against_position,
    # It relieves the drive, so it may exceed the drive's own torque.
    possible=lambda theta, shape, limits: bool(np.hypot(*theta) < MOST * limits.torque),
    display=describe_wave(0, 1, "N m"),
)
