"""Masses, lengths and gravity of a whole robot file that no arm has."""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from residual.robot.dynamics import compute_last_joint_distance

EARTH = (9.6, 10.0)  # m/s^2


@dataclass(frozen=True, slots=True)
class FileFlaw:
    """What is wrong with a whole robot file."""

    words: str
    certain: bool = True
    scale: float | None = None  # of all its lengths, or masses, that mends it


def find_unit_flaw(model: pin.Model) -> FileFlaw | None:
    """Find masses or lengths of a whole file that are in another unit."""
    bodies = list(model.inertias)[1:]
    mass, last = sum(b.mass for b in bodies), bodies[-1]
    reach = compute_last_joint_distance(model) + np.linalg.norm(last.lever)
    if not reach:  # a wheel: its radius
        reach = np.sqrt(np.trace(last.inertia) / max(last.mass, 1e-9))
    density = mass / max(reach, 1e-6) ** 3  # kg/m^3 of the cube of the reach
    # A weight at the end of a lever is as dense as a ball of steel about the joint.
    densest = 1e3 if len(bodies) > 2 else 3e4
    for there, sizes, unit, scale in (
        (reach > 50.0, "lengths", "millimetres", 1e-3),
        (density > densest and reach > 0.05, "masses", "grams", 1e-3),
        (reach < 0.01 and mass > 1, "lengths", "kilometres", 1e3),
        (density < 1e-2, "masses", "tonnes", 1e3),
    ):
        if there:
            words = (
                f"The arm weighs {mass:.4g} kg and reaches {reach:.4g} m: its {sizes} "
                f"look like {unit}."
            )
            return FileFlaw(words, scale=scale)
    return None


def find_gravity_flaw(model: pin.Model) -> FileFlaw | None:
    """Find gravity of another size than the earth's."""
    size = float(np.linalg.norm(model.gravity.linear))
    if not size or EARTH[0] < size < EARTH[1]:
        return None
    words = f"Gravity is {size:.4g} m/s^2 in the robot file, expected 9.81."
    return FileFlaw(words, certain=size > 3 * EARTH[1])
