"""Pick and place: quintic moves between points, with dwells in which nothing moves."""

import numpy as np

from sim.synthetic.room import Room, draw_centre

Array = np.ndarray

_POINTS = 5
_DWELL = (0.3, 0.9)  # s
# Largest speed and acceleration of the quintic, for a unit move in unit time.
_SPEED, _ACCELERATION = 1.875, 10 / np.sqrt(3)


def move_stop_move(
    space: Room, t: Array, duration: float, rng: np.random.Generator
) -> tuple[Array, Array, Array]:
    """Draw a program of moves and repeat it until the time is over.

    Each move follows q = a + (b - a)(10x^3 - 15x^4 + 6x^5), so speed and acceleration
    are zero at its ends. The log starts and ends with a dwell.

    Args:
        t: Sample times from 0 [s]. Shape (n,).
        duration: Length of the motion [s].

    Returns:
        Positions, velocities and accelerations. Shapes (n, dof).
    """
    dof = len(space.centre)
    reach = 0.9 * space.amplitude * rng.uniform(-1, 1, (_POINTS, dof))
    points = draw_centre(space, rng) + reach
    slower = rng.uniform(1.0, 1.5, _POINTS)
    dwells = rng.uniform(*_DWELL, _POINTS)
    q = np.tile(points[0], (len(t), 1))
    qd, qdd = np.zeros((2, *q.shape))
    now = dwells[0]
    for step in range(1, 1000):
        start, end = points[(step - 1) % _POINTS], points[step % _POINTS]
        time = slower[step % _POINTS] * move_time(
            end - start, space.velocity, space.acceleration
        )
        if now + time > duration - _DWELL[0]:
            break
        moving = (t >= now) & (t < now + time)
        x = ((t[moving] - now) / time)[:, None]
        q[moving], qd[moving], qdd[moving] = quintic(start, end, time, x)
        q[t >= now + time] = end
        now += time + dwells[step % _POINTS]
    return q, qd, qdd


def quintic(
    start: Array, end: Array, time: float, x: Array
) -> tuple[Array, Array, Array]:
    """Return position, velocity and acceleration of a move from rest to rest.

    Args:
        start: First position [rad]. Shape (dof,).
        end: Last position [rad]. Shape (dof,).
        time: How long the move takes [s].
        x: Shares of that time, from 0 to 1. Shape (n, 1).

    Returns:
        q, qd and qdd. Shapes (n, dof).
    """
    return (
        start + (end - start) * (10 * x**3 - 15 * x**4 + 6 * x**5),
        (end - start) / time * 30 * x**2 * (1 - x) ** 2,
        (end - start) / time**2 * 60 * x * (1 - x) * (1 - 2 * x),
    )


def move_time(distance: Array, velocity: Array, acceleration: Array) -> float:
    """Return the shortest time in which all joints keep their limits [s].

    Args:
        distance: How far each joint goes [rad]. Shape (dof,).
        velocity: Speed limits [rad/s]. Shape (dof,).
        acceleration: Acceleration limits [rad/s^2]. Shape (dof,).
    """
    distance = np.abs(distance)
    by_speed = _SPEED * distance / velocity
    by_acceleration = np.sqrt(_ACCELERATION * distance / acceleration)
    return max(0.4, float(by_speed.max()), float(by_acceleration.max()))
