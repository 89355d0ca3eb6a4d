"""The cogging of a magnet at order q + phase."""

from sim.effects.base import Effect, build_row_function, draw_angle
from sim.engine import friction_laws

EFFECT = Effect(
    name="ripple",
    parameters={"amplitude": "N m", "order": "1", "phase": "rad"},
    defaults={"phase": 0.0},
    amount=("amplitude",),
    draw=lambda rng, sizes: {
        "amplitude": rng.uniform(0.01, 0.04) * sizes.torque,
        "order": rng.uniform(6.0, 50.0),
        "phase": draw_angle(rng),
    },
    torque=build_row_function(friction_laws.RIPPLE, "amplitude", "order", "phase"),
)
