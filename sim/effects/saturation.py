"""A torque sensor at the end of its range; the drive itself gives more."""

import numpy as np

from sim.effects.base import Effect, Trait, first_joints

EFFECT = Effect(
    name="saturation",
    parameters={"level": "N m"},
    above={"level": 0.0},
    traits=frozenset({Trait.RARE}),
    where=first_joints,
    draw=lambda rng, sizes: {"level": rng.uniform(0.5, 0.75) * sizes.torque},
    report=lambda tau, t, onset, p: np.clip(tau, -p["level"], p["level"]),
)
