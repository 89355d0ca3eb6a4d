"""A soft gear: the motor, on which the encoder sits, leads by load / stiffness."""

from sim.effects.base import Effect, PlantEffectTrait, draw_first_joint

EFFECT = Effect(
    name="elasticity",
    parameters={"stiffness": "N m/rad"},
    above={"stiffness": 0.0},
    amount=("stiffness",),
    traits=frozenset({PlantEffectTrait.INVERSE, PlantEffectTrait.RARE}),
    where=draw_first_joint,
    draw=lambda rng, sizes: {"stiffness": rng.uniform(3e3, 1.5e4)},
    transmission=lambda p: (1.0 / p["stiffness"], 0.0),
)
