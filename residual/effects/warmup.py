"""Friction that falls while the grease warms up."""

from residual.effects.base import (
    Effect,
    EffectTrait,
    ShapeRefinement,
    append_shape,
    build_local_law,
    dissipates,
)


def _shapes(span, j):
    taus = (15.0, 30.0, 60.0, 120.0, 240.0, 900.0, 3600.0)
    return tuple((c,) for c in taus if span.duration / 6 <= c <= 2.5 * span.duration)


EFFECT = Effect(
    name="warmup",
    noun="friction that falls as the arm warms up",
    sentence="friction that falls with the time since the session began",
    equation="tau = level * exp(-t / time_constant) * sgn(qd)",
    parameters={"level": "N m", "time_constant": "s"},
    **build_local_law("sign * exp(-t / s[0])"),
    from_values=append_shape,
    shapes=_shapes,
    refine=ShapeRefinement("ratio", 0.6),
    traits=EffectTrait.NEEDS_CLOCK | EffectTrait.FRICTION,
    # One over time and two time constants: 7 to 34 % from this level at the start.
    inexact=0.15,
    variable=lambda state, j: (state.t, "session time [s]"),
    possible=dissipates,
)
