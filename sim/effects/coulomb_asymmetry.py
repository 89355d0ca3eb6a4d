"""More dry friction in one direction: level max(z, 0) - level min(z, 0)."""

from sim.effects.base import Effect, build_row_function, draw_sign
from sim.engine import friction_laws

EFFECT = Effect(
    name="coulomb_asymmetry",
    parameters={"level": "N m"},
    amount=("level",),
    draw=lambda rng, sizes: {"level": draw_sign(rng) * rng.uniform(0.1, 0.4) * sizes.coulomb},
    friction=build_row_function(friction_laws.ASYMMETRY, "level"),
)
