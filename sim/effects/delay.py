"""Torque that is reported late, on all joints."""

import numpy as np

from sim.effects.base import Effect, PlantEffectTrait


def _late(tau, t, onset, p):
    then = t - p["delay"]
    return np.column_stack([np.interp(then, t, column) for column in tau.T])


EFFECT = Effect(
    name="delay",
    parameters={"delay": "s"},
    scope="global",
    above={"delay": 0.0},
    amount=("delay",),
    traits=frozenset({PlantEffectTrait.RARE}),
    draw=lambda rng, sizes: {"delay": rng.uniform(0.004, 0.02)},
    report=_late,
)
