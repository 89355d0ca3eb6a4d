"""Viscous friction: a change of the declared one."""

from sim.effects.base import Effect, build_row_function
from sim.engine import friction_laws

EFFECT = Effect(
    name="viscous",
    parameters={"coefficient": "N m s/rad"},
    of_drive="viscous",
    amount=("coefficient",),
    draw=lambda rng, sizes: {"coefficient": rng.uniform(0.3, 1.0) * sizes.viscous},
    friction=build_row_function(friction_laws.VISCOUS, "coefficient"),
)
