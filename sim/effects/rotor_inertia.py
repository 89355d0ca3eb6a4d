"""Another rotor: d/dt dT/dqd = inertia qdd of the motor's T = 1/2 inertia qd^2."""

from sim.effects.base import Effect

EFFECT = Effect(
    name="rotor_inertia",
    parameters={"inertia": "kg m^2"},
    of_drive="rotor",
    amount=("inertia",),
    draw=lambda rng, sizes: {"inertia": rng.uniform(0.3, 1.0) * sizes.rotor},
)
