"""A constant torque."""

from sim.effects.base import Effect, build_row_function, draw_sign
from sim.engine import friction_laws

EFFECT = Effect(
    name="offset",
    parameters={"torque": "N m"},
    amount=("torque",),
    draw=lambda rng, sizes: {"torque": draw_sign(rng) * rng.uniform(0.02, 0.06) * sizes.torque},
    torque=build_row_function(friction_laws.CONSTANT, "torque"),
)
