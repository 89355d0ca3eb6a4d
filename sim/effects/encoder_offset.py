"""An encoder mounted with a small angular error."""

import numpy as np

from sim.effects.base import Effect, PlantEffectTrait, draw_any_joint, draw_sign

EFFECT = Effect(
    name="encoder_offset",
    parameters={"angle": "rad"},
    amount=("angle",),
    traits=frozenset({PlantEffectTrait.RARE}),
    where=draw_any_joint,
    draw=lambda rng, sizes: {"angle": draw_sign(rng) * np.deg2rad(rng.uniform(0.5, 2.0))},
    encoder=lambda p: (p["angle"], 0.0, 0.0),
)
