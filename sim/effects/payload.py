"""A load fixed to the flange: a steel ball, unless its tensor is given."""

import pinocchio as pin

from residual.robot.dynamics import find_flange_axis, find_flange_placement
from sim.effects.base import (
    BODY,
    CENTRE,
    Effect,
    Rng,
    TypicalJointSizes,
    Values,
    add_body,
    build_body_inertia,
)


def add_payload(model: pin.Model, p: Values) -> pin.Model:
    """Return a copy of an arm whose last body is the sum of link and load.

    Args:
        p: The load's values, in the flange frame.

    Raises:
        InputError: If no body can have the given tensor.
    """
    body = find_flange_placement(model).act(build_body_inertia(p))
    return add_body(model, model.njoints - 1, body, "Payload")


def _draw(rng: Rng, sizes: TypicalJointSizes) -> dict[str, float]:
    """Draw 1 to 6 kg at 70 to 200 mm on a 100-kg arm, in proportion on others."""
    model = sizes.robot.model
    # The moving bodies of the 98-kg arm weigh 72 kg.
    arm = sum(body.mass for body in list(model.inertias)[1:])
    mass = rng.uniform(1.0, 6.0) * min(1.0, arm / 72.0)
    axis = find_flange_axis(model)
    lateral = rng.uniform(-0.05, 0.05, 3)
    centre = rng.uniform(0.07, 0.2) * axis + lateral - (lateral @ axis) * axis
    return {"mass": float(mass), **dict(zip(CENTRE, map(float, centre), strict=True))}


EFFECT = Effect(
    name="payload",
    **BODY,
    scope="flange",
    draw=_draw,
    body=lambda model, joints, p: add_payload(model, p),
)
