"""z a (cos x + 0.1 cos 2x), x = q - atan2(sin, cos), a = |(cos, sin)|.

With the base friction: Fc (1 + (a / Fc) cos x + ...), an eccentric gear wheel.
"""

import numpy as np

from sim.effects.base import Effect, draw_angle, split_into_components
from sim.engine import friction_laws


def _polar(p):
    return np.hypot(p["cos"], p["sin"]), np.arctan2(p["sin"], p["cos"])


EFFECT = Effect(
    name="position_friction",
    parameters={"cos": "N m", "sin": "N m"},
    amount=("cos", "sin"),
    draw=lambda rng, sizes: split_into_components(
        rng.uniform(0.2, 0.5) * sizes.coulomb, draw_angle(rng)
    ),
    friction=lambda p, level: (friction_laws.POSITION, *_polar(p)),
)
