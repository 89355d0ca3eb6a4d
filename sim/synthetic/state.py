"""What a hidden effect is, and what it may look at."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

Array = np.ndarray


@dataclass(frozen=True, eq=False, slots=True)
class Hidden:
    """An effect that the arm has and its model may lack.

    Attributes:
        name: Name of the effect; those out of the vocabulary begin with "x_".
        joints: Joints that have it, from 1.
        parameters: SI values; an array has one entry per joint.
    """

    name: str
    joints: tuple[int, ...]
    parameters: Mapping[str, float | Array]


@dataclass(frozen=True, eq=False, slots=True)
class State:
    """The true state of the arm during one log, for one hidden effect.

    Kinematics and friction have one column per joint of the effect (k of them), in the
    order of Hidden.joints.

    Attributes:
        t: Session time: zero when the session began, pauses counted [s]. Shape (n,).
        q: True positions [rad]. Shape (n, k).
        qd: True velocities [rad/s]. Shape (n, k).
        qdd: True accelerations [rad/s^2]. Shape (n, k).
        bristle: State of the dry friction, -1 to 1. Shape (n, k).
        load: True torque of the rigid body [N m]. Shape (n, k).
        coulomb: True Coulomb level of the base friction [N m]. Shape (k,).
        displacement: Displacement over which the bristles yield [rad]. Shape (k,).
        rng: Random stream of this effect in this log.
    """

    t: Array
    q: Array
    qd: Array
    qdd: Array
    bristle: Array
    load: Array
    coulomb: Array
    displacement: Array
    rng: np.random.Generator
