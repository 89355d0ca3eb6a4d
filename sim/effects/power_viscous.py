"""coefficient qd times the viscosity of grease that shears."""

from sim.effects.base import Effect, row
from sim.engine import laws


def _law(state, p):
    thin = laws.power_viscosity(state.qd, p["exponent"])
    return p["coefficient"] * state.qd * thin


EFFECT = Effect(
    name="power_viscous",
    parameters={"coefficient": "N m (s/rad)^p", "exponent": "1"},
    amount=("coefficient",),
    draw=lambda rng, sizes: {
        "coefficient": rng.uniform(0.3, 1.0) * sizes.viscous,
        "exponent": rng.uniform(0.3, 0.7),
    },
    friction=row(laws.POWER, "coefficient", "exponent"),
    law=_law,
)
