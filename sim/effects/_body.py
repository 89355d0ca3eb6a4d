"""A body that is bolted to a link: what a load and what a link carries have alike."""

import numpy as np
import pinocchio as pin

from residual.errors import InputError
from sim.effects.base import Values

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


def _least(body: pin.Inertia) -> float:
    return np.linalg.eigvalsh(pin.PseudoInertia.FromInertia(body).toMatrix())[0]
