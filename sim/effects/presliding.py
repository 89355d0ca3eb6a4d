"""level z of another contact, whose bristles yield further."""

from sim.effects.base import Effect, PlantEffectTrait, build_row_function, draw_any_joint
from sim.engine import friction_laws

EFFECT = Effect(
    name="presliding",
    parameters={"level": "N m", "displacement": "rad"},
    above={"level": 0.0, "displacement": 0.0},
    traits=frozenset({PlantEffectTrait.RARE}),
    # level z = level sgn(qd) + level (z - sgn(qd)), and the first is that friction.
    also=("coulomb",),
    where=draw_any_joint,
    draw=lambda rng, sizes: {"level": sizes.coulomb, "displacement": rng.uniform(0.003, 0.03)},
    friction=build_row_function(friction_laws.BRISTLE, "level", "displacement"),
)
