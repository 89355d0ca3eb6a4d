"""Constant torque: current-sensor bias, or a constant load."""

import numpy as np

from residual.effects.base import Effect, Trait, formula, local, within_torque

EFFECT = Effect(
    name="offset",
    noun="a constant torque offset",
    sentence="a constant torque, as from a biased current sensor",
    equation="tau = torque",
    parameters={"torque": "N m"},
    columns=local(lambda state, j, shape: [np.ones(len(state.t))]),
    family="static",
    traits=Trait.CONSTANT | Trait.GROUPABLE,
    possible=within_torque,
    in_any_arm=lambda span, j: ((),),
    portable=formula("a[0]", joint=("constant",)),
)
