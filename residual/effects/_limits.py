"""What no arm can be: signs and sizes that several effects share.

Each is the ``possible`` of an effect: (coefficients, shape, limits) -> bool.
"""

import numpy as np

from residual.effects.base import Limits, Shape
from residual.recording import Array

SLACK = 0.1  # of what the model has: by so much a change may overshoot it


def within_torque(theta: Array, shape: Shape, limits: Limits) -> bool:
    """Of either sign, and no larger than the torque of the joint."""
    return bool(np.linalg.norm(theta) <= limits.torque)


def stays_positive(theta: Array, shape: Shape, limits: Limits) -> bool:
    """With what the model has of it, not negative: an inertia, or a friction.

    A change may overshoot what the model has by a little, since both have an error.
    """
    had = limits.had if len(limits.had) == len(theta) else np.zeros(len(theta))
    total = had + theta
    return bool(np.all(np.where(had > 0, total > -SLACK * had, total > 0)))


def dissipates(theta: Array, shape: Shape, limits: Limits) -> bool:
    """Friction takes power; and no joint moves against more than its torque."""
    return stays_positive(theta, shape, limits) and within_torque(theta, shape, limits)


def dissipates_with_speed(theta: Array, shape: Shape, limits: Limits) -> bool:
    """The same of friction per speed, at the speed that the joint was seen at."""
    positive = stays_positive(theta, shape, limits)
    return positive and within_torque(theta * limits.speed, shape, limits)
