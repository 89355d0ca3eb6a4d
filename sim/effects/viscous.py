"""Viscous friction: a change of what the drive has."""

from sim.effects.base import Effect, row
from sim.engine import laws

EFFECT = Effect(
    name="viscous",
    parameters={"coefficient": "N m s/rad"},
    of_drive="viscous",
    amount=("coefficient",),
    draw=lambda rng, sizes: {"coefficient": rng.uniform(0.3, 1.0) * sizes.viscous},
    friction=row(laws.VISCOUS, "coefficient"),
    law=lambda state, p: p["coefficient"] * state.qd,
)
