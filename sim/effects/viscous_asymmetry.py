"""+coefficient qd forwards and -coefficient qd backwards, blended by z."""

from sim.effects.base import Effect, build_row_function, draw_sign
from sim.engine import friction_laws

EFFECT = Effect(
    name="viscous_asymmetry",
    parameters={"coefficient": "N m s/rad"},
    amount=("coefficient",),
    draw=lambda rng, sizes: {"coefficient": draw_sign(rng) * rng.uniform(0.1, 0.4) * sizes.viscous},
    friction=build_row_function(friction_laws.VISCOUS_ASYMMETRY, "coefficient"),
)
