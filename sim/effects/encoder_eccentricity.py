"""An encoder disk off its axis: it errs once per turn."""

import numpy as np

from sim.effects.base import (
    Effect,
    PlantEffectTrait,
    draw_angle,
    draw_any_joint,
    split_into_components,
)

EFFECT = Effect(
    name="encoder_eccentricity",
    parameters={"cos": "rad", "sin": "rad"},
    amount=("cos", "sin"),
    traits=frozenset({PlantEffectTrait.RARE}),
    where=draw_any_joint,
    draw=lambda rng, sizes: split_into_components(
        np.deg2rad(rng.uniform(0.3, 1.0)), draw_angle(rng)
    ),
    encoder=lambda p: (0.0, p["cos"], p["sin"]),
)
