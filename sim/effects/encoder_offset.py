"""An encoder that was mounted a little off."""

import numpy as np

from sim.effects.base import Effect, Trait, any_joint, sign

EFFECT = Effect(
    name="encoder_offset",
    parameters={"angle": "rad"},
    amount=("angle",),
    traits=frozenset({Trait.RARE}),
    where=any_joint,
    draw=lambda rng, sizes: {"angle": sign(rng) * np.deg2rad(rng.uniform(0.5, 2.0))},
    encoder=lambda p: (p["angle"], 0.0, 0.0),
)
