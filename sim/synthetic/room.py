"""The room in which a robot may move: ranges, speeds and accelerations."""

from dataclasses import dataclass

import numpy as np

from residual.robot.robot import Robot

Array = np.ndarray

_MARGIN = 0.05  # rad kept free at each end of the range
_WIDEST = 1.3  # rad; larger sweeps add nothing and would hit a real cell
_SHARE_OF_SPEED = 0.5
_FASTEST = 3.0  # rad/s
_UNKNOWN_SPEED = 2.0  # rad/s, where the robot states no limit


@dataclass(frozen=True, eq=False, slots=True)
class Room:
    """What a motion may use.

    Attributes:
        lower: Lower end of the positions [rad]. Shape (dof,).
        upper: Upper end of the positions [rad]. Shape (dof,).
        centre: Usual middle of a motion [rad]. Shape (dof,).
        amplitude: Largest deviation from the middle of a motion [rad]. Shape (dof,).
        velocity: Largest speed [rad/s]. Shape (dof,).
        acceleration: Largest acceleration [rad/s^2]. Shape (dof,).
    """

    lower: Array
    upper: Array
    centre: Array
    amplitude: Array
    velocity: Array
    acceleration: Array


def room(robot: Robot) -> Room:
    """Return the room of a robot, inside its limits with a margin."""
    lower = np.maximum(robot.lower, -np.pi) + _MARGIN
    upper = np.minimum(robot.upper, np.pi) - _MARGIN
    amplitude = np.minimum(0.35 * (upper - lower), _WIDEST)
    limit = np.asarray(robot.velocity_limit, dtype=float)
    known = np.isfinite(limit) & (limit > 0)
    velocity = np.where(known, _SHARE_OF_SPEED * limit, _UNKNOWN_SPEED)
    velocity = np.minimum(velocity, _FASTEST)
    acceleration = velocity / 0.15
    if robot.acceleration_limit is not None:
        acceleration = np.minimum(acceleration, 0.9 * robot.acceleration_limit)
    # As near to the zero posture as the range allows: there arms carry their weight.
    centre = np.clip(0.0, lower + amplitude, upper - amplitude)
    return Room(lower, upper, centre, amplitude, velocity, acceleration)


def draw_centre(space: Room, rng: np.random.Generator) -> Array:
    """Return the middle of one motion, up to 0.3 rad off the usual one [rad]."""
    centre = space.centre + rng.uniform(-0.3, 0.3, len(space.centre))
    return np.clip(centre, space.lower + space.amplitude, space.upper - space.amplitude)
