"""Limits of an arm, and the usual conditions on the size and sign of an effect."""

from dataclasses import dataclass

import numpy as np

from residual.recording import Array

Shape = tuple[float, ...]


@dataclass(frozen=True, eq=False, slots=True)
class Limits:
    """What an arm can do where an effect sits; of the whole arm the largest.

    Attributes:
        torque: Largest torque of the joint, by its limit or as it was logged [N m].
        lower, upper: Ends of its range [rad].
        speed: Speed that it was seen at, a 95 % quantile [rad/s].
        weight: Mass of the arm [kg].
        reach: Length of the arm when it is stretched [m].
        had: Coefficients of the same effect that the model has, as refitted; zero where
            it has none. Shape (k,).
    """

    torque: float
    lower: float
    upper: float
    speed: float
    weight: float
    reach: float
    had: Array


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
