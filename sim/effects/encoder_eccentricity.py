"""An encoder disk off its axis: it errs once per turn."""

import numpy as np

from sim.effects.base import Effect, Trait, any_joint, split, turn

EFFECT = Effect(
    name="encoder_eccentricity",
    parameters={"cos": "rad", "sin": "rad"},
    amount=("cos", "sin"),
    traits=frozenset({Trait.RARE}),
    where=any_joint,
    draw=lambda rng, sizes: split(np.deg2rad(rng.uniform(0.3, 1.0)), turn(rng)),
    encoder=lambda p: (0.0, p["cos"], p["sin"]),
)
