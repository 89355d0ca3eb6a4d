"""Friction of a gear that turns with u = q_i + sign q_j, felt by both joints.

f = level z(u) + coefficient u'; torque (f, sign f), z a bristle driven by u.
"""

from sim.effects.base import Effect, draw_sign

EFFECT = Effect(
    name="coupled_friction",
    parameters={"level": "N m", "coefficient": "N m s/rad", "inertia": "kg m^2", "sign": "1"},
    defaults={"coefficient": 0.0, "inertia": 0.0, "sign": 1.0},
    scope="pair",
    signs=("sign",),
    amount=("level",),
    along=("coefficient", "inertia"),
    draw=lambda rng, sizes: {
        "level": rng.uniform(0.3, 0.8) * sizes.coulomb,
        "coefficient": rng.uniform(0.1, 0.3) * sizes.viscous,
        "sign": draw_sign(rng),
    },
    gear=lambda p: (p["inertia"], p["sign"], p["level"], p["coefficient"]),
)
