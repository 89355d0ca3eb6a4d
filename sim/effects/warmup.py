"""Friction that decreases as its power warms the gear."""

from sim.effects.base import Effect, build_row_function
from sim.engine import friction_laws

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
)
