"""Friction that fades as the gear warms up.

On synthetic arms level z (0.75 exp(-t/T) + 0.25 exp(-t/(3T))): oil, then the housing;
in the physics engine the friction itself heats.
"""

import numpy as np

from sim.effects.base import Effect, build_row_function
from sim.engine import friction_laws


def _law(state, p):
    oil = np.exp(-state.t / p["time_constant"])
    fade = 0.75 * oil + 0.25 * oil ** (1 / 3)
    return p["level"] * fade[:, None] * state.bristle


EFFECT = Effect(
    name="warmup",
    parameters={"level": "N m", "time_constant": "s"},
    above={"time_constant": 0.0},
    amount=("level",),
    draw=lambda rng, sizes: {
        "level": rng.uniform(0.3, 0.8) * sizes.coulomb,
        "time_constant": rng.uniform(40.0, 150.0),
    },
    friction=build_row_function(friction_laws.WARMUP, "level", "time_constant"),
    law=_law,
)
