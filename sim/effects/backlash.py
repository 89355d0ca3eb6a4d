"""Play in the gear: the motor leads by half of it, to the side that the load is on."""

import numpy as np
from scipy.ndimage import uniform_filter1d

from sim.effects.base import Effect, PlantEffectTrait, draw_first_joint

CROSSING = 0.04  # s that a link takes from one side of its play to the other


def _lead(load, rate, p):
    side = np.sign(load)
    for _ in range(3):
        side = uniform_filter1d(side, max(1, round(CROSSING * rate / 2)))
    return p["half_gap"] * side


EFFECT = Effect(
    name="backlash",
    parameters={"half_gap": "rad"},
    above={"half_gap": 0.0},
    amount=("half_gap",),
    traits=frozenset({PlantEffectTrait.RARE}),
    where=draw_first_joint,
    draw=lambda rng, sizes: {"half_gap": rng.uniform(5e-4, 3e-3)},
    transmission=lambda p: (0.0, p["half_gap"]),
    lead=_lead,
)
