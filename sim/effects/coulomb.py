"""Dry friction: a change of the declared one."""

from sim.effects.base import Effect, build_row_function
from sim.engine import friction_laws

EFFECT = Effect(
    name="coulomb",
    parameters={"level": "N m"},
    of_drive="coulomb",
    amount=("level",),
    draw=lambda rng, sizes: {"level": rng.uniform(0.3, 1.0) * sizes.coulomb},
    friction=build_row_function(friction_laws.LEVEL, "level"),
)
