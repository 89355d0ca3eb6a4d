"""coefficient qd times the viscosity of churning oil."""

from sim.effects.base import Effect, row
from sim.engine import laws


def _law(state, p):
    return p["coefficient"] * state.qd * laws.quadratic_viscosity(state.qd)


EFFECT = Effect(
    name="quadratic_viscous",
    parameters={"coefficient": "N m s^2/rad^2"},
    amount=("coefficient",),
    draw=lambda rng, sizes: {"coefficient": rng.uniform(0.15, 0.5) * sizes.viscous},
    friction=row(laws.QUADRATIC, "coefficient"),
    law=_law,
)
