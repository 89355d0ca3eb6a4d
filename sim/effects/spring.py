"""stiffness times q - rest: a hose that softens."""

from sim.effects.base import Effect, row
from sim.engine import laws

EFFECT = Effect(
    name="spring",
    parameters={"stiffness": "N m/rad", "rest": "rad"},
    defaults={"rest": 0.0},
    amount=("stiffness",),
    draw=lambda rng, sizes: {
        "stiffness": rng.uniform(0.03, 0.1) * sizes.torque,
        "rest": rng.uniform(-0.3, 0.3) + sizes.centre,
    },
    torque=row(laws.HOSE, "stiffness", "rest"),
    law=lambda state, p: p["stiffness"] * laws.hose(state.q - p["rest"]),
)
