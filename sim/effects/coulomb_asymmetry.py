"""More dry friction in one direction: level max(z, 0) - level min(z, 0)."""

import numpy as np

from sim.effects.base import Effect, build_row_function, draw_sign
from sim.engine import friction_laws


def _law(state, p):
    forward, backward = np.maximum(state.bristle, 0), np.minimum(state.bristle, 0)
    return p["level"] * forward - p["level"] * backward


EFFECT = Effect(
    name="coulomb_asymmetry",
    parameters={"level": "N m"},
    amount=("level",),
    draw=lambda rng, sizes: {
        "level": draw_sign(rng) * rng.uniform(0.1, 0.4) * sizes.coulomb
    },
    friction=build_row_function(friction_laws.ASYMMETRY, "level"),
    law=_law,
)
