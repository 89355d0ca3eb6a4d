"""A load fixed to the flange: a steel ball, unless its tensor is given."""

import math

import numpy as np
import pinocchio as pin

from residual.errors import InputError
from residual.robot.dynamics import flange_placement, outward
from sim.effects.base import Effect, Here, Rng, Values

TENSOR = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
CENTRE = ("com_x", "com_y", "com_z")


def body_of(p: Values) -> pin.Inertia:
    """Return a body by its values, in the frame that they are stated in.

    Args:
        p: `mass` [kg] and `com_x`, `com_y`, `com_z` [m]; `ixx` to `izz` about that
            centre [kg m^2], NaN where they are not known.
    """
    # Radius of a steel ball of that mass (7850 kg/m^3).
    radius = (3 * p["mass"] / (4 * np.pi * 7850.0)) ** (1 / 3)
    inertia = 0.4 * p["mass"] * radius**2 * np.eye(3)
    if not np.isnan(p["ixx"]):
        inertia[np.triu_indices(3)] = [p[key] for key in TENSOR]
        inertia = np.triu(inertia) + np.triu(inertia, 1).T
    return pin.Inertia(p["mass"], np.array([p[key] for key in CENTRE]), inertia)


def added(model: pin.Model, link: int, body: pin.Inertia, name: str) -> pin.Model:
    """Return a copy of an arm with a body more on a link.

    Args:
        link: Index of its joint in the model.
        name: What a message calls the body.

    Raises:
        InputError: If no link can have the sum.
    """
    loaded = pin.Model(model)
    loaded.inertias[link] += body
    if _least(loaded.inertias[link]) < 0:
        raise InputError(
            f"{name}: no body has these moments of inertia at that mass; give them "
            "about the centre of mass, each at most the sum of the other two."
        )
    return loaded


def with_load(model: pin.Model, p: Values) -> pin.Model:
    """Return a copy of an arm whose last body is the sum of link and load.

    Args:
        p: The load's values, in the flange frame.

    Raises:
        InputError: If no body can have the given tensor.
    """
    body = flange_placement(model).act(body_of(p))
    return added(model, model.njoints - 1, body, "Payload")


def _least(body: pin.Inertia) -> float:
    return np.linalg.eigvalsh(pin.PseudoInertia.FromInertia(body).toMatrix())[0]


def _usual(rng: Rng, here: Here) -> dict[str, float]:
    """Draw 1 to 6 kg at 70 to 200 mm on a 100-kg arm, in proportion on others."""
    model = here.robot.model
    # The moving bodies of the 98-kg arm weigh 72 kg.
    arm = sum(body.mass for body in list(model.inertias)[1:])
    mass = rng.uniform(1.0, 6.0) * min(1.0, arm / 72.0)
    axis = outward(model)
    lateral = rng.uniform(-0.05, 0.05, 3)
    centre = rng.uniform(0.07, 0.2) * axis + lateral - (lateral @ axis) * axis
    return {"mass": float(mass), **dict(zip(CENTRE, map(float, centre), strict=True))}


EFFECT = Effect(
    name="payload",
    parameters={"mass": "kg"}
    | dict.fromkeys(CENTRE, "m")
    | dict.fromkeys(TENSOR, "kg m^2"),
    defaults=dict.fromkeys(CENTRE, 0.0) | dict.fromkeys(TENSOR, math.nan),
    scope="flange",
    above={"mass": 0.0},
    together=TENSOR,
    amount=("mass",),
    usual=_usual,
    body=lambda model, joints, p: with_load(model, p),
)
