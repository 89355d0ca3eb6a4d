"""Viscous friction that differs between the two directions of motion."""

import numpy as np

from residual.effects.base import (
    Effect,
    EffectTrait,
    build_formula_law,
    build_joint_columns,
    stays_within_torque,
)

EFFECT = Effect(
    name="viscous_asymmetry",
    noun="viscous friction that differs by direction",
    sentence="viscous friction that is stronger in one direction than in the other",
    equation="tau = coefficient * |qd|",
    parameters={"coefficient": "N m s/rad"},
    columns=build_joint_columns(lambda state, j, shape: [np.abs(state.qd[:, j])]),
    possible=lambda theta, shape, limits: stays_within_torque(
        theta * limits.speed, shape, limits
    ),
    traits=EffectTrait.FRICTION,
    in_any_arm=lambda span, j: ((),),
    portable=build_formula_law("a[0] * fabs(qd)"),
)
