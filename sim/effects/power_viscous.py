"""coefficient qd times the viscosity of grease that shears."""

from sim.effects.base import Effect, build_row_function
from sim.engine import friction_laws

EFFECT = Effect(
    name="power_viscous",
    parameters={"coefficient": "N m (s/rad)^p", "exponent": "1"},
    amount=("coefficient",),
    draw=lambda rng, sizes: {
        "coefficient": rng.uniform(0.3, 1.0) * sizes.viscous,
        "exponent": rng.uniform(0.3, 0.7),
    },
    friction=build_row_function(friction_laws.POWER, "coefficient", "exponent"),
)
