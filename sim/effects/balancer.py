"""A gas spring of peak |(cos, sin)|: close to p_sin sin q + p_cos cos q."""

import numpy as np

from sim.effects.base import Effect, JointSizes, Rng, balanced, sign, split
from sim.engine import laws


def _polar(p):
    return np.hypot(p["cos"], p["sin"]), np.arctan2(-p["cos"], p["sin"])


def _law(state, p):
    size, zero = _polar(p)
    return size * laws.gas_spring(state.q - zero) / laws.gas_spring_peak()


def _row(p, joints):
    size, zero = _polar(p)
    return laws.GAS_SPRING, size / laws.gas_spring_peak(), zero


def _draw(rng: Rng, sizes: JointSizes) -> dict[str, float]:
    """Near the phase that helps against weight: where else would one mount it?"""
    size = sign(rng) * rng.uniform(0.05, 0.15) * sizes.torque
    return split(size, np.pi / 2 + rng.uniform(-0.5, 0.5))


EFFECT = Effect(
    name="balancer",
    parameters={"cos": "N m", "sin": "N m"},
    amount=("cos", "sin"),
    where=balanced,
    draw=_draw,
    torque=_row,
    law=_law,
)
