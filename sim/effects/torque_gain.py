"""A wrong torque constant: the drives give less torque than they report."""

from sim.effects.base import Effect, draw_loaded_joint, draw_sign

EFFECT = Effect(
    name="torque_gain",
    parameters={"gain": "1"},
    above={"gain": -1.0},
    amount=("gain",),
    where=draw_loaded_joint,
    draw=lambda rng, sizes: {"gain": draw_sign(rng) * rng.uniform(0.05, 0.15)},
    gain=lambda p: p["gain"],
)
