"""Dry friction: a change of what the drive has."""

from sim.effects.base import Effect, row
from sim.engine import laws

EFFECT = Effect(
    name="coulomb",
    parameters={"level": "N m"},
    of_drive="coulomb",
    amount=("level",),
    draw=lambda rng, sizes: {"level": rng.uniform(0.3, 1.0) * sizes.coulomb},
    friction=row(laws.LEVEL, "level"),
    law=lambda state, p: p["level"] * state.bristle,
)
