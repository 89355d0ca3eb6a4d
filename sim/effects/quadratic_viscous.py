"""coefficient qd times the viscosity of churning oil."""

from sim.effects.base import Effect, build_row_function
from sim.engine import friction_laws

EFFECT = Effect(
    name="quadratic_viscous",
    parameters={"coefficient": "N m s^2/rad^2"},
    amount=("coefficient",),
    draw=lambda rng, sizes: {"coefficient": rng.uniform(0.15, 0.5) * sizes.viscous},
    friction=build_row_function(friction_laws.QUADRATIC, "coefficient"),
)
