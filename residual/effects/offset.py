"""Constant torque: current-sensor bias, or a constant load."""

import numpy as np

from residual.effects.base import (
    Effect,
    EffectTrait,
    build_formula_law,
    build_joint_columns,
    stays_within_torque,
)

EFFECT = Effect(
    name="offset",
    noun="a constant torque offset",
    sentence="a constant torque, as from a biased current sensor",
    equation="tau = torque",
    parameters={"torque": "N m"},
    columns=build_joint_columns(lambda state, j, shape: [np.ones(len(state.t))]),
    family="static",
    traits=EffectTrait.CONSTANT | EffectTrait.GROUPABLE,
    possible=stays_within_torque,
    in_any_arm=lambda span, j: ((),),
    portable=build_formula_law("a[0]", joint=("constant",)),
)
