"""A load fixed to the flange: a steel ball, unless its tensor is given."""

import math

import numpy as np
import pinocchio as pin

from residual.errors import InputError
from residual.robot.dynamics import flange_placement, outward
from sim.effects.base import Effect, Here, Rng, Values

_TENSOR = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
_CENTRE = ("com_x", "com_y", "com_z")


def with_load(model: pin.Model, p: Values) -> pin.Model:
    """Return a copy of an arm whose last body is the sum of link and load.

    Args:
        p: `mass` [kg] and `com_x`, `com_y`, `com_z` [m] in the flange frame; `ixx` to
            `izz` about that centre [kg m^2], NaN where they are not known.

    Raises:
        InputError: If no body can have the given tensor.
    """
    # Radius of a steel ball of that mass (7850 kg/m^3).
    radius = (3 * p["mass"] / (4 * np.pi * 7850.0)) ** (1 / 3)
    inertia = 0.4 * p["mass"] * radius**2 * np.eye(3)
    given = not np.isnan(p["ixx"])
    if given:
        inertia[np.triu_indices(3)] = [p[key] for key in _TENSOR]
        inertia = np.triu(inertia) + np.triu(inertia, 1).T
    load = pin.Inertia(p["mass"], np.array([p[key] for key in _CENTRE]), inertia)
    loaded = pin.Model(model)
    loaded.inertias[loaded.njoints - 1] += flange_placement(model).act(load)
    if given and _least(loaded.inertias[loaded.njoints - 1]) < 0:
        raise InputError(
            "Payload: no body has these moments of inertia at that mass; give them "
            "about the centre of mass, each at most the sum of the other two."
        )
    return loaded


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
    return {"mass": float(mass), **dict(zip(_CENTRE, map(float, centre), strict=True))}


EFFECT = Effect(
    name="payload",
    parameters={"mass": "kg"}
    | dict.fromkeys(_CENTRE, "m")
    | dict.fromkeys(_TENSOR, "kg m^2"),
    defaults=dict.fromkeys(_CENTRE, 0.0) | dict.fromkeys(_TENSOR, math.nan),
    scope="flange",
    above={"mass": 0.0},
    together=_TENSOR,
    amount=("mass",),
    usual=_usual,
    body=lambda model, joints, p: with_load(model, p),
)
