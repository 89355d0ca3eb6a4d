"""stiffness times q - rest: a hose that softens."""

from sim.effects.base import Effect, build_row_function
from sim.engine import friction_laws

EFFECT = Effect(
    name="spring",
    parameters={"stiffness": "N m/rad", "rest": "rad"},
    defaults={"rest": 0.0},
    amount=("stiffness",),
    draw=lambda rng, sizes: {
        "stiffness": rng.uniform(0.03, 0.1) * sizes.torque,
        "rest": rng.uniform(-0.3, 0.3) + sizes.centre,
    },
    torque=build_row_function(friction_laws.HOSE, "stiffness", "rest"),
)
