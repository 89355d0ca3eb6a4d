"""Torque ripple: cogging, gear mesh or belt, periodic in the joint's position."""

import numpy as np

from residual.effects.base import (
    Effect,
    EffectTrait,
    ShapeRefinement,
    against_position,
    build_local_law,
    stays_within_torque,
)


def _shapes(span, j):
    """Orders that the travel resolves and the identification filter passes.

    Two neighbours differ by at most 2.4 rad of phase over the travel: a wave half way
    between them keeps 89 % of its power, and the search from there has one peak.
    """
    travel = max(span.travel[j], 1e-3)
    slides = span.prismatic and span.prismatic[j]
    lowest = max(4.0, 3 * np.pi / travel)
    highest = 2 * np.pi * span.cutoff / max(0.25 * span.speed[j], 1e-3)
    highest = min(600.0 if slides else 60.0, highest)
    step = min(8.0 if slides else 1.6, 2.4 / travel)
    return tuple((float(n),) for n in np.arange(lowest, highest, step))


def _from_values(values, robot):
    amplitude, order, phase = values
    return amplitude * np.array([np.cos(phase), -np.sin(phase)]), (float(order),)


EFFECT = Effect(
    name="ripple",
    noun="torque ripple",
    sentence="a torque periodic in the joint's position (cogging or gear mesh)",
    equation="tau = amplitude * cos(order * q + phase)",
    parameters={"amplitude": "N m", "order": "1", "phase": "rad"},
    sliding={"order": "rad/m", "phase": "rad"},
    **build_local_law("cos(s[0] * q)", "sin(s[0] * q)"),
    values=lambda theta, shape, robot: np.array(
        [np.hypot(*theta), shape[0], np.arctan2(-theta[1], theta[0])]
    ),
    from_values=_from_values,
    shapes=_shapes,
    refine=ShapeRefinement("shift", 0.8, sliding=4.0),
    traits=EffectTrait.PERIODIC,
    variable=against_position,
    possible=stays_within_torque,
    in_any_arm=lambda span, j: ((1.0,), (2.0,), (3.0,)),
)
