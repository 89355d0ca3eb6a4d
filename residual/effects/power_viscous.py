"""Viscous friction that grows less than linearly with speed (shear thinning)."""

import numpy as np

from residual.effects.base import (
    Effect,
    EffectTrait,
    ShapeRefinement,
    append_shape,
    build_formula_law,
    build_joint_columns,
    dissipates,
)

EFFECT = Effect(
    name="power_viscous",
    noun="viscous friction that grows less than linearly",
    sentence="viscous friction that grows less than linearly with speed",
    equation="tau = coefficient * |qd|^exponent * sgn(qd), exponent below 1",
    parameters={"coefficient": "N m (s/rad)^p", "exponent": "1"},
    columns=build_joint_columns(
        lambda s, j, shape: [np.sign(s.qd[:, j]) * np.abs(s.qd[:, j]) ** shape[0]]
    ),
    from_values=append_shape,
    shapes=lambda span, j: ((0.25,), (0.5,), (0.75,)),
    refine=ShapeRefinement("ratio", 0.4, lower=0.05, upper=0.95),
    traits=EffectTrait.GROUPABLE | EffectTrait.FRICTION,
    possible=lambda theta, shape, limits: dissipates(
        theta * limits.speed ** shape[0], shape, limits
    ),
    portable=build_formula_law("a[0] * sgn(qd) * pow(fabs(qd), s[0])"),
)
