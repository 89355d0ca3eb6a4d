"""A report of torque that ends at the range of its sensor."""

import numpy as np

from residual.effects.base import (
    Effect,
    EffectTrait,
    ShapeRefinement,
    against_torque,
    build_local_law,
)

# The coefficient is one for the right clip; an incomplete model may need more.
LEAST, MOST = 0.5, 2.0


def _shapes(span, j):
    """The plateau is near the largest torques of the log."""
    top = 0.0 if span.torque is None else float(span.torque[j])
    return ((0.9 * top,), (top,)) if top > 0 else ()


EFFECT = Effect(
    name="saturation",
    noun="torque saturation",
    sentence="a report of torque that ends at a certain size",
    equation="d tau = clip(tau, -level, level) - tau",
    parameters={"level": "N m"},
    **build_local_law("(fmin(fmax(tau, -s[0]), s[0]) - tau)"),
    values=lambda theta, shape, robot: np.array([shape[0]]),
    from_values=lambda values, robot: (np.ones(1), (float(values[0]),)),
    shapes=_shapes,
    refine=ShapeRefinement("ratio", 0.1),
    traits=EffectTrait.USES_MODEL | EffectTrait.REPORT,
    prior_sd=lambda robot: np.array([1.0]),
    possible=lambda theta, shape, limits: bool(LEAST < theta[0] < MOST),
    variable=against_torque,
)
