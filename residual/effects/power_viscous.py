"""Viscous friction that grows less than linearly with speed (shear thinning)."""

import numpy as np

from residual.effects.base import (
    Effect,
    Refinement,
    Trait,
    dissipates,
    formula,
    local,
    shaped,
)

EFFECT = Effect(
    name="power_viscous",
    noun="viscous friction that grows less than linearly",
    sentence="viscous friction that grows less than linearly with speed",
    equation="tau = coefficient * |qd|^exponent * sgn(qd), exponent below 1",
    parameters={"coefficient": "N m (s/rad)^p", "exponent": "1"},
    columns=local(
        lambda s, j, shape: [np.sign(s.qd[:, j]) * np.abs(s.qd[:, j]) ** shape[0]]
    ),
    from_values=shaped,
    shapes=lambda span, j: ((0.25,), (0.5,), (0.75,)),
    refine=Refinement("ratio", 0.4, lower=0.05, upper=0.95),
    traits=Trait.GROUPABLE | Trait.FRICTION,
    possible=lambda theta, shape, limits: dissipates(
        theta * limits.speed ** shape[0], shape, limits
    ),
    portable=formula("a[0] * sgn(qd) * pow(fabs(qd), s[0])"),
)
