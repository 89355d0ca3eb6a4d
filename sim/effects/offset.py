"""A constant torque."""

import numpy as np

from sim.effects.base import Effect, row, sign
from sim.engine import laws

EFFECT = Effect(
    name="offset",
    parameters={"torque": "N m"},
    amount=("torque",),
    draw=lambda rng, sizes: {
        "torque": sign(rng) * rng.uniform(0.02, 0.06) * sizes.torque
    },
    torque=row(laws.CONSTANT, "torque"),
    law=lambda state, p: p["torque"] * np.ones_like(state.q),
)
