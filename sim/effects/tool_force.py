"""A constant force on the flange, in the base frame."""

import numpy as np
import pinocchio as pin

from residual.robot.dynamics import find_flange_frame, find_flange_placement
from sim.effects.base import (
    Array,
    Effect,
    MovingArm,
    PlantEffectTrait,
    Rng,
    TypicalJointSizes,
    Values,
)


def _force(p: Values) -> Array:
    return np.array([p[axis] for axis in "xyz"])


def _push(p: Values, arm: MovingArm) -> Array:
    """Return J' force."""
    frame = find_flange_frame(arm.model)
    jacobian = pin.computeFrameJacobian(
        arm.model, arm.data, arm.q, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    )
    return jacobian[:3].T @ _force(p)


def _load(model: pin.Model, q: Array, p: Values) -> Array:
    """Return what a weight of 1 kg at the flange takes in a field of that strength."""
    bare = pin.Model(model)
    for i in range(1, bare.njoints):
        bare.inertias[i] = pin.Inertia.Zero()
    point = pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3)))
    bare.inertias[bare.njoints - 1] = find_flange_placement(model).act(point)
    bare.gravity.linear = _force(p)
    data = bare.createData()
    return np.array([pin.computeGeneralizedGravity(bare, data, x) for x in q])


def _draw(rng: Rng, sizes: TypicalJointSizes) -> dict[str, float]:
    push = rng.normal(size=3)
    push *= rng.uniform(10.0, 40.0) / np.linalg.norm(push)
    return dict(zip("xyz", map(float, push), strict=True))


EFFECT = Effect(
    name="tool_force",
    parameters=dict.fromkeys("xyz", "N"),
    defaults=dict.fromkeys("xyz", 0.0),
    scope="global",
    amount=("x", "y", "z"),
    traits=frozenset({PlantEffectTrait.RARE}),
    draw=_draw,
    push=_push,
    load=_load,
)
