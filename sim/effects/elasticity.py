"""A soft gear: the motor, on which the encoder sits, leads by load / stiffness."""

from sim.effects.base import Effect, Trait, first_joints

EFFECT = Effect(
    name="elasticity",
    parameters={"stiffness": "N m/rad"},
    above={"stiffness": 0.0},
    amount=("stiffness",),
    traits=frozenset({Trait.INVERSE, Trait.RARE}),
    where=first_joints,
    draw=lambda rng, sizes: {"stiffness": rng.uniform(3e3, 1.5e4)},
    transmission=lambda p: (1.0 / p["stiffness"], 0.0),
    lead=lambda load, rate, p: load / p["stiffness"],
)
