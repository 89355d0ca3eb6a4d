"""Stribeck friction: extra friction at low speed that fades as the film builds up.

The textbook form level·exp(-|qd/vs|^exponent) (Armstrong-Hélouvry 1994).
"""

import numpy as np

from residual.effects.base import (
    Effect,
    EffectTrait,
    ShapeRefinement,
    append_shape,
    build_local_law,
    dissipates,
)


def _shapes(span, j, velocities=(0.03, 0.06, 0.12, 0.24), exponents=(1.0, 2.0)):
    velocities = np.array(velocities) * max(span.speed[j], 1e-3)
    return tuple((float(v), e) for v in velocities for e in exponents)


EFFECT = Effect(
    name="stribeck",
    noun="Stribeck friction",
    sentence="extra friction at low speed that fades as the joint speeds up",
    equation="tau = level * exp(-|qd / velocity|^exponent) * sgn(qd)",
    parameters={"level": "N m", "velocity": "rad/s", "exponent": "1"},
    **build_local_law("sign * exp(-pow(fabs(qd / s[0]), s[1]))"),
    from_values=append_shape,
    shapes=_shapes,
    refine=ShapeRefinement("ratio", 0.6),
    traits=EffectTrait.NOT_NEGATIVE | EffectTrait.FRICTION,
    possible=dissipates,
    in_any_arm=lambda span, j: _shapes(span, j, (0.03, 0.06, 0.12), (1.0,)),
    least_seen=tuple((velocity, 1.0) for velocity in (0.06, 0.12)),  # rad/s
)
