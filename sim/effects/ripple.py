"""The cogging of a magnet at order q + phase."""

from sim.effects.base import Effect, row, turn
from sim.engine import laws


def _law(state, p):
    return p["amplitude"] * laws.magnet(p["order"] * state.q + p["phase"])


EFFECT = Effect(
    name="ripple",
    parameters={"amplitude": "N m", "order": "1", "phase": "rad"},
    defaults={"phase": 0.0},
    amount=("amplitude",),
    draw=lambda rng, sizes: {
        "amplitude": rng.uniform(0.01, 0.04) * sizes.torque,
        "order": rng.uniform(6.0, 50.0),
        "phase": turn(rng),
    },
    torque=row(laws.RIPPLE, "amplitude", "order", "phase"),
    law=_law,
)
