"""+coefficient qd forwards and -coefficient qd backwards, blended by z."""

from sim.effects.base import Effect, row, sign
from sim.engine import laws

EFFECT = Effect(
    name="viscous_asymmetry",
    parameters={"coefficient": "N m s/rad"},
    amount=("coefficient",),
    draw=lambda rng, sizes: {
        "coefficient": sign(rng) * rng.uniform(0.1, 0.4) * sizes.viscous
    },
    friction=row(laws.VISCOUS_ASYMMETRY, "coefficient"),
    law=lambda state, p: p["coefficient"] * state.qd * state.bristle,
)
