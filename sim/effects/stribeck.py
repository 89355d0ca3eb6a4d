"""level z / (1 + (qd / velocity)^2): a Lorentzian (Hess 1990), not an exponential."""

from sim.effects.base import Effect, build_row_function
from sim.engine import friction_laws

EFFECT = Effect(
    name="stribeck",
    parameters={"level": "N m", "velocity": "rad/s", "exponent": "1"},
    defaults={"exponent": 2.0},
    above={"velocity": 0.0},
    amount=("level",),
    draw=lambda rng, sizes: {
        "level": rng.uniform(0.2, 0.6) * sizes.coulomb,
        "velocity": rng.uniform(0.03, 0.15),
    },
    friction=build_row_function(friction_laws.STRIBECK, "level", "velocity", "exponent"),
)
