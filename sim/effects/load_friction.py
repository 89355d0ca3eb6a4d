"""coefficient sqrt(load^2 + e^2) z with e a tenth of the Coulomb level."""

from sim.effects.base import Effect, draw_loaded_joint
from sim.engine import friction_laws

EFFECT = Effect(
    name="load_friction",
    parameters={"coefficient": "1"},
    amount=("coefficient",),
    where=draw_loaded_joint,
    draw=lambda rng, sizes: {"coefficient": rng.uniform(0.03, 0.1)},
    friction=lambda p, level: (friction_laws.CARRIED, p["coefficient"], 0.1 * level),
)
