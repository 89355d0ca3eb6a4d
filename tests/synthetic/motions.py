"""Motions of four families: positions with exact velocities and accelerations.

fourier: five harmonics (paper eq. 4); cyclic and slow_cyclic: strokes of a painting
program; move_stop_move: pick and place with real dwells. Limits hold between the
samples as well: they are imposed on bounds of the continuous curves.
"""

import numpy as np

from residual.recording import Array
from residual.robot.robot import Robot
from sim.engine.plant_records import ReferenceMotion
from sim.plant.typical_sizes import UsualMotionRange as Space
from sim.plant.typical_sizes import compute_usual_motion_range
from sim.plant.typical_sizes import draw_motion_centre as motion_centre
from sim.trajectories.planning_limits import (
    RAMP,
    bound_series_peaks,
    evaluate_quintic_move,
    evaluate_ramped_series,
    find_shortest_move_time,
)
from sim.trajectories.planning_limits import FourierSeries as Series

FAMILIES = ("fourier", "cyclic", "slow_cyclic", "move_stop_move")
_RAMP_PEAK = 1.875 / RAMP  # largest rate of the path speed [1/s]
_POINTS = 5
_DWELL = (0.3, 0.9)  # s


def make_motion(
    family: str, robot: Robot, duration: float, rate: float, rng: np.random.Generator
) -> ReferenceMotion:
    """Draw one motion of some seconds at a rate [Hz], which does not decide it.

    Raises:
        ValueError: If there is no such family.
    """
    space, t = compute_usual_motion_range(robot), np.arange(round(duration * rate)) / rate
    match family:
        case "fourier":
            curve = draw_fourier(space, duration, rng)
        case "cyclic":
            curve = draw_cyclic(space, 5.0, 0.8, rng)
        case "slow_cyclic":
            curve = draw_cyclic(space, 10.0, 0.3, rng)
        case "move_stop_move":
            motion = move_stop_move(space, t, duration, rng)
            return ReferenceMotion(family, t, *motion, None)
        case _:
            raise ValueError(f"No motion family {family!r}; there are {FAMILIES}.")
    return ReferenceMotion(family, t, *evaluate_ramped_series(curve, t, duration), None)


def draw_fourier(space: Space, duration: float, rng: np.random.Generator) -> Series:
    """Draw five harmonics; two periods fit into the duration."""
    dof = len(space.centre)
    order = np.arange(1, 6)[:, None]
    sine, cosine = rng.normal(size=(2, 5, dof)) / order
    period = (duration - RAMP) / 2
    return _within(space, Series(motion_centre(space, rng), sine, cosine, period), 1.0)


def draw_cyclic(space: Space, period: float, share: float, rng: np.random.Generator) -> Series:
    """Draw strokes back and forth: 1 to 3 per period and joint, nearly triangular."""
    dof = len(space.centre)
    strokes = rng.permutation(np.arange(dof) // 2 % 3 + 1)
    phase = rng.uniform(0, 2 * np.pi, dof)
    sine, cosine = np.zeros((2, 9, dof))
    for joint, n in enumerate(strokes):
        # A third harmonic of 1/9 would be the triangle; 0.07 keeps the turns soft.
        for order, weight in ((n, 1.0), (3 * n, -0.07)):
            angle = order // n * phase[joint]
            sine[order - 1, joint] = weight * np.cos(angle)
            cosine[order - 1, joint] = weight * np.sin(angle)
    series = Series(motion_centre(space, rng), sine, cosine, period)
    return _within(space, series, share)


def move_stop_move(
    space: Space, t: Array, duration: float, rng: np.random.Generator
) -> tuple[Array, Array, Array]:
    """Draw a program of moves and repeat it; return q, qd and qdd at times from 0.

    Each move follows q = a + (b - a)(10x^3 - 15x^4 + 6x^5), so speed and acceleration
    are zero at its ends. The log starts and ends with a dwell.
    """
    dof = len(space.centre)
    reach = 0.9 * space.amplitude * rng.uniform(-1, 1, (_POINTS, dof))
    points = motion_centre(space, rng) + reach
    slower = rng.uniform(1.0, 1.5, _POINTS)
    dwells = rng.uniform(*_DWELL, _POINTS)
    q = np.tile(points[0], (len(t), 1))
    qd, qdd = np.zeros((2, *q.shape))
    now = dwells[0]
    for step in range(1, 1000):
        start, end = points[(step - 1) % _POINTS], points[step % _POINTS]
        time = slower[step % _POINTS] * find_shortest_move_time(
            end - start, space.velocity, space.acceleration
        )
        if now + time > duration - _DWELL[0]:
            break
        moving = (t >= now) & (t < now + time)
        x = ((t[moving] - now) / time)[:, None]
        q[moving], qd[moving], qdd[moving] = evaluate_quintic_move(start, end, time, x)
        q[t >= now + time] = end
        now += time + dwells[step % _POINTS]
    return q, qd, qdd


def _within(space: Space, series: Series, share: float) -> Series:
    """Scale each joint as large as its range (times share), speed and acceleration."""
    position, velocity, acceleration = bound_series_peaks(series)
    scale = np.min(
        [
            share * space.amplitude / position,
            space.velocity / velocity,
            space.acceleration / (acceleration + _RAMP_PEAK * velocity),
        ],
        axis=0,
    )
    return Series(series.centre, scale * series.sine, scale * series.cosine, series.period)
