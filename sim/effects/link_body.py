"""A body bolted to a link: a steel ball by its joint, unless its tensor is given."""

import numpy as np

from sim.effects.base import (
    BODY,
    CENTRE,
    Effect,
    PlantEffectTrait,
    Rng,
    TypicalJointSizes,
    add_body,
    build_body_inertia,
)


def _with_body(model, joints, p):
    for joint in joints:
        model = add_body(model, joint + 1, build_body_inertia(p), "Body on a link")
    return model


def _draw(rng: Rng, sizes: TypicalJointSizes) -> dict[str, float]:
    """Draw 2 to 8 % of the moving arm's mass, 8 to 20 cm from the joint."""
    arm = sum(body.mass for body in list(sizes.robot.model.inertias)[1:])
    way = rng.normal(size=3)
    centre = rng.uniform(0.08, 0.2) * way / np.linalg.norm(way)
    mass = float(rng.uniform(0.02, 0.08) * arm)
    return {"mass": mass, **dict(zip(CENTRE, map(float, centre), strict=True))}


EFFECT = Effect(
    name="link_body",
    **BODY,
    traits=frozenset({PlantEffectTrait.RARE}),
    # The first turns about one axis alone, and on the wrist it is a load.
    where=lambda rng, dof, sizes: int(rng.integers(2, max(3, dof - 1))),
    draw=_draw,
    body=_with_body,
)
