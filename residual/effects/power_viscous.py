"""Viscous friction that grows less than linearly with speed (shear thinning)."""

from residual.effects.base import (
    Effect,
    EffectTrait,
    ShapeRefinement,
    append_shape,
    build_local_law,
    dissipates,
)

EFFECT = Effect(
    name="power_viscous",
    noun="viscous friction that grows less than linearly",
    sentence="viscous friction that grows less than linearly with speed",
    equation="tau = coefficient * |qd|^exponent * sgn(qd), exponent below 1",
    parameters={"coefficient": "N m (s/rad)^p", "exponent": "1"},
    **build_local_law("sgn(qd) * pow(fabs(qd), s[0])"),
    from_values=append_shape,
    shapes=lambda span, j: ((0.25,), (0.5,), (0.75,)),
    refine=ShapeRefinement("ratio", 0.4, lower=0.05, upper=0.95),
    traits=EffectTrait.GROUPABLE | EffectTrait.FRICTION,
    possible=lambda theta, shape, limits: dissipates(
        theta * limits.speed ** shape[0], shape, limits
    ),
)
