"""A body bolted to a link: a ball of steel beside its joint."""

import numpy as np
import pinocchio as pin

from sim.effects.base import Effect

_STEEL = 7850.0  # kg/m^3


def _with_ball(model, joints, p):
    changed = pin.Model(model)
    radius = (0.75 * p["mass"] / (np.pi * _STEEL)) ** (1 / 3)
    centre = np.array([p["com_x"], p["com_y"], p["com_z"]])
    inertia = 0.4 * p["mass"] * radius**2 * np.eye(3)
    for joint in joints:
        changed.inertias[joint + 1] += pin.Inertia(p["mass"], centre, inertia)
    return changed


def _usual(rng, here):
    """Draw 2 to 8 % of the moving arm's mass, within 20 cm of the joint."""
    arm = sum(body.mass for body in list(here.robot.model.inertias)[1:])
    way = rng.normal(size=3)
    centre = rng.uniform(0.08, 0.2) * way / np.linalg.norm(way)
    values = {"mass": float(rng.uniform(0.02, 0.08) * arm)}
    return values | {f"com_{axis}": float(x) for axis, x in zip("xyz", centre, strict=True)}


EFFECT = Effect(
    name="link_body",
    parameters={"mass": "kg", "com_x": "m", "com_y": "m", "com_z": "m"},
    above={"mass": 0.0},
    amount=("mass",),
    rare=True,
    where=lambda rng, dof, usual: int(rng.integers(2, max(3, dof - 1))),
    usual=_usual,
    body=_with_ball,
)
