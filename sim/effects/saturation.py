"""A torque sensor at the end of its range; the drive itself gives more."""

import numpy as np

from sim.effects.base import Effect, PlantEffectTrait, draw_first_joint

EFFECT = Effect(
    name="saturation",
    parameters={"level": "N m"},
    above={"level": 0.0},
    traits=frozenset({PlantEffectTrait.RARE}),
    where=draw_first_joint,
    draw=lambda rng, sizes: {"level": rng.uniform(0.5, 0.75) * sizes.torque},
    report=lambda tau, t, onset, p: np.clip(tau, -p["level"], p["level"]),
)
