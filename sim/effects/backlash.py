"""Play in the gear: the motor leads by half of it, to the side that the load is on."""

from sim.effects.base import Effect, PlantEffectTrait, draw_first_joint

EFFECT = Effect(
    name="backlash",
    parameters={"half_gap": "rad"},
    above={"half_gap": 0.0},
    amount=("half_gap",),
    traits=frozenset({PlantEffectTrait.RARE}),
    where=draw_first_joint,
    draw=lambda rng, sizes: {"half_gap": rng.uniform(5e-4, 3e-3)},
    transmission=lambda p: (0.0, p["half_gap"]),
)
