"""A constant force on the flange, in the base frame."""

import numpy as np
import pinocchio as pin

from residual.robot.dynamics import find_flange_frame
from sim.effects.base import (
    Array,
    Effect,
    MovingArm,
    PlantEffectTrait,
    Rng,
    TypicalJointSizes,
    Values,
)


def _push(p: Values, arm: MovingArm) -> Array:
    """Return J' force."""
    frame = find_flange_frame(arm.model)
    jacobian = pin.computeFrameJacobian(
        arm.model, arm.data, arm.q, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    )
    # Pinocchio gives a matrix of one column as a vector.
    return jacobian.reshape(6, -1)[:3].T @ np.array([p[axis] for axis in "xyz"])


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
)
