"""coefficient sqrt(load^2 + e^2) z with e a tenth of the Coulomb level."""

from sim.effects.base import Effect, draw_loaded_joint
from sim.engine import friction_laws


def _law(state, p):
    load = friction_laws.preloaded_torque(state.load, 0.1 * state.coulomb)
    return p["coefficient"] * load * state.bristle


EFFECT = Effect(
    name="load_friction",
    parameters={"coefficient": "1"},
    amount=("coefficient",),
    where=draw_loaded_joint,
    draw=lambda rng, sizes: {"coefficient": rng.uniform(0.03, 0.1)},
    friction=lambda p, level: (friction_laws.CARRIED, p["coefficient"], 0.1 * level),
    law=_law,
)
