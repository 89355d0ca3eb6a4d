"""Friction that grows with the square of speed (churning oil)."""

import numpy as np

from residual.effects.base import (
    Effect,
    EffectTrait,
    build_formula_law,
    build_joint_columns,
    dissipates_with_speed,
)

EFFECT = Effect(
    name="quadratic_viscous",
    noun="friction that grows with the square of speed",
    sentence="resistance that grows with the square of speed (churning grease)",
    equation="tau = coefficient * qd * |qd|",
    parameters={"coefficient": "N m s^2/rad^2"},
    columns=build_joint_columns(
        lambda state, j, shape: [state.qd[:, j] * np.abs(state.qd[:, j])]
    ),
    traits=EffectTrait.GROUPABLE | EffectTrait.FRICTION,
    possible=lambda theta, shape, limits: dissipates_with_speed(
        theta * limits.speed, shape, limits
    ),
    in_any_arm=lambda span, j: ((),),
    portable=build_formula_law("a[0] * qd * fabs(qd)", joint=("quadratic_damping",)),
)
