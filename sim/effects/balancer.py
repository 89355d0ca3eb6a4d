"""A gas spring of peak |(cos, sin)|: close to p_sin sin q + p_cos cos q."""

import numpy as np

from sim.effects.base import (
    Effect,
    Rng,
    TypicalJointSizes,
    draw_balanced_joint,
    draw_sign,
    split_into_components,
)
from sim.engine import friction_laws


def _row(p, joints):
    size, zero = np.hypot(p["cos"], p["sin"]), np.arctan2(-p["cos"], p["sin"])
    return friction_laws.GAS_SPRING, size / friction_laws.gas_spring_peak_torque(), zero


def _draw(rng: Rng, sizes: TypicalJointSizes) -> dict[str, float]:
    """Draw a phase near the one that balances the weight."""
    size = draw_sign(rng) * rng.uniform(0.05, 0.15) * sizes.torque
    return split_into_components(size, np.pi / 2 + rng.uniform(-0.5, 0.5))


EFFECT = Effect(
    name="balancer",
    parameters={"cos": "N m", "sin": "N m"},
    amount=("cos", "sin"),
    where=draw_balanced_joint,
    draw=_draw,
    torque=_row,
)
