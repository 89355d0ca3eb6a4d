"""A link of another density: all ten of its parameters are scaled."""

import pinocchio as pin

from sim.effects.base import Effect, PlantEffectTrait, draw_first_joint, draw_sign


def _denser(model, joints, p):
    changed, factor = pin.Model(model), 1 + p["scale"]
    for joint in joints:
        body = changed.inertias[joint + 1]
        changed.inertias[joint + 1] = pin.Inertia(
            factor * body.mass, body.lever, factor * body.inertia
        )
    return changed


EFFECT = Effect(
    name="link_inertia",
    parameters={"scale": "1"},
    above={"scale": -1.0},
    amount=("scale",),
    traits=frozenset({PlantEffectTrait.RARE}),
    where=draw_first_joint,
    draw=lambda rng, sizes: {"scale": draw_sign(rng) * rng.uniform(0.15, 0.3)},
    body=_denser,
)
