"""Curves in time: Fourier series, quick moves, paths; stages, put together.

Each starts and ends at rest.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev

from residual.recording import Array

Motion = tuple[Array, Array, Array]  # q, qd and qdd, shapes (n, dof)
Curve = Callable[[Array], Motion]  # at any times, shape (n,)

RAMP = 1.0  # s in which a series goes from rest to full speed, and back at the end
_STROKE_RAMP = 0.2  # share of a stroke in which it gathers speed, and loses it again
# Largest speed and acceleration of the quintic, for a unit move in unit time.
_SPEED, _ACCELERATION = 1.875, 10 / np.sqrt(3)


@dataclass(frozen=True, eq=False, slots=True)
class FourierSeries:
    """q(s) = centre + sum_k sine_k sin(k w s) + cosine_k cos(k w s).

    w = 2 pi / period.
    """

    centre: Array  # middle of the motion [rad], (dof,)
    sine: Array  # coefficients of harmonics 1 to h [rad], (h, dof)
    cosine: Array  # coefficients of harmonics 1 to h [rad], (h, dof)
    period: float  # length of one period [s]


def evaluate_ramped_series(
    series: FourierSeries, t: Array, duration: float
) -> tuple[Array, Array, Array]:
    """Return positions, velocities and accelerations at the times t.

    The path time s(t) starts and ends at rest: q = q(s), qd = q' s', and
    qdd = q'' s'^2 + q' s''.
    """
    s, sd, sdd = compute_ramped_time(t, duration)
    q, first, second = (differentiate_series(series, s, d) for d in range(3))
    sd, sdd = sd[:, None], sdd[:, None]
    return series.centre + q, first * sd, second * sd**2 + first * sdd


def bound_series_peaks(series: FourierSeries) -> tuple[Array, Array, Array]:
    """Return bounds of |q - centre|, |q'| and |q''| that hold for every s. (dof,)."""
    s = np.linspace(0, series.period, 400)
    size = np.hypot(series.sine, series.cosine)
    rate = 2 * np.pi / series.period * np.arange(1, len(size) + 1)[:, None]
    step = s[1] - s[0]

    def largest(times: int) -> Array:
        # Between two grid points a curve exceeds them by at most h^2/8 max|f''|.
        bend = (size * rate ** (times + 2)).sum(axis=0)
        grid = np.abs(differentiate_series(series, s, times)).max(axis=0)
        return grid + step**2 / 8 * bend

    position, velocity, acceleration = (largest(d) for d in range(3))
    return position, velocity, acceleration


def differentiate_series(series: FourierSeries, s: Array, order: int) -> Array:
    """Return the d-th derivative of q - centre with respect to s. Shape (n, dof)."""
    rate = 2 * np.pi / series.period * np.arange(1, len(series.sine) + 1)
    angle = np.outer(s, rate) + order * np.pi / 2
    factor = rate[:, None] ** order
    return np.sin(angle) @ (factor * series.sine) + np.cos(angle) @ (factor * series.cosine)


def compute_ramped_time(
    t: Array, duration: float, ramp: float = RAMP
) -> tuple[Array, Array, Array]:
    """Return s, s' and s'': s' rises over one ramp by 10x^3 - 15x^4 + 6x^5.

    Args:
        duration: Length of the motion, at least two ramps [s].
        ramp: Time from rest to s' = 1 and back [s].

    Returns:
        Path time [s], which ends at duration - ramp, and its derivatives. Shape (n,).
    """
    rise, fall = (np.clip(x / ramp, 0, 1) for x in (t, duration - t))

    def area(x: Array) -> Array:
        return ramp * (2.5 * x**4 - 3 * x**5 + x**6)

    def height(x: Array) -> Array:
        return 10 * x**3 - 15 * x**4 + 6 * x**5

    def slope(x: Array) -> Array:
        return 30 * x**2 * (1 - x) ** 2 / ramp

    plateau = np.clip(t - ramp, 0, duration - 2 * ramp)
    s = area(rise) + plateau + ramp / 2 - area(fall)
    return s, height(rise) + height(fall) - 1, slope(rise) - slope(fall)


def evaluate_quintic_move(
    start: Array, end: Array, time: float, x: Array
) -> tuple[Array, Array, Array]:
    """Return position, velocity and acceleration of a move from rest to rest. (n, dof).

    Args:
        x: Shares of that time, from 0 to 1. Shape (n, 1).
    """
    return (
        start + (end - start) * (10 * x**3 - 15 * x**4 + 6 * x**5),
        (end - start) / time * 30 * x**2 * (1 - x) ** 2,
        (end - start) / time**2 * 60 * x * (1 - x) * (1 - 2 * x),
    )


def find_shortest_move_time(way: Array, velocity: Array, acceleration: Array) -> float:
    """Return the shortest time in which all joints keep their limits [s]."""
    way = np.abs(way)
    by_speed = _SPEED * way / velocity
    by_acceleration = np.sqrt(_ACCELERATION * way / acceleration)
    return max(0.4, float(by_speed.max()), float(by_acceleration.max()))


@dataclass(frozen=True, eq=False, slots=True)
class MotionStage:
    """A part of a program."""

    time: float  # how long it takes [s]
    motion: Curve  # q, qd and qdd at times from its own start


def build_dwell(q: Array, time: float) -> MotionStage:
    """Return a stage in which nothing moves. Shape of q (dof,)."""

    def motion(t: Array) -> Motion:
        still = np.zeros((len(t), len(q)))
        return still + q, still, still

    return MotionStage(time, motion)


def build_joint_move(start: Array, end: Array, time: float) -> MotionStage:
    """Return a move of all joints together, by a polynomial of fifth order."""
    return MotionStage(time, lambda t: evaluate_quintic_move(start, end, time, t[:, None] / time))


@dataclass(frozen=True, eq=False, slots=True)
class JointPath:
    """Joint angles along a path, q(x) for x from 0 to 1."""

    coefficients: Array  # of Chebyshev polynomials in 2 x - 1, (order + 1, dof)

    def at(self, x: Array, order: int = 0) -> Array:
        """Return the d-th derivative by x. Shape (n, dof)."""
        slope = chebyshev.chebder(self.coefficients, order) * 2.0**order
        return chebyshev.chebval(2 * x - 1, slope).T


def compute_path_nodes(count: int) -> Array:
    """Return where a path must be known, from 0 to 1, both included. (count,)."""
    return (chebyshev.chebpts2(count) + 1) / 2


def interpolate_joint_path(q: Array) -> JointPath:
    """Return the path through joint angles at the nodes. Shape (nodes, dof)."""
    points = chebyshev.chebpts2(len(q))
    return JointPath(chebyshev.chebfit(points, q, len(q) - 1))


def build_path_stage(path: JointPath, time: float, constant_speed: bool) -> MotionStage:
    """Return a stage that follows a path.

    Args:
        constant_speed: Whether the speed along the path is even but for its ends; else
            the path is run through in the way of a quick move.
    """

    def motion(t: Array) -> Motion:
        if constant_speed:
            ramp = _STROKE_RAMP * time
            x, xd, xdd = (v / (time - ramp) for v in compute_ramped_time(t, time, ramp))
        else:
            unit = evaluate_quintic_move(np.zeros(1), np.ones(1), time, t[:, None] / time)
            x, xd, xdd = (v[:, 0] for v in unit)
        first, second = path.at(x, 1), path.at(x, 2)
        xd, xdd = xd[:, None], xdd[:, None]
        return path.at(x), first * xd, second * xd**2 + first * xdd

    return MotionStage(time, motion)


def find_shortest_stage_time(stage: MotionStage, velocity: Array, acceleration: Array) -> float:
    """Return the time in which a stage just keeps speeds and accelerations [s].

    Slower by a factor, a stage from rest to rest has speeds lower by that factor and
    accelerations by its square.
    """
    _, qd, qdd = stage.motion(np.linspace(0, stage.time, 400))
    by_speed = (np.abs(qd) / velocity).max()
    by_acceleration = np.sqrt((np.abs(qdd) / acceleration).max())
    return stage.time * float(max(by_speed, by_acceleration))


def repeat_stages(stages: list[MotionStage]) -> Curve:
    """Return the motion that runs through the stages again and again."""
    ends = np.cumsum([stage.time for stage in stages])

    def motion(t: Array) -> Motion:
        own = np.mod(t, ends[-1])
        which = np.minimum(np.searchsorted(ends, own, side="right"), len(stages) - 1)
        parts = np.zeros((3, len(t), stages[0].motion(np.zeros(1))[0].shape[1]))
        for i, stage in enumerate(stages):
            rows = np.flatnonzero(which == i)
            inside = own[rows] - (ends[i] - stage.time)
            parts[:, rows] = stage.motion(np.clip(inside, 0.0, stage.time))
        q, qd, qdd = parts
        return q, qd, qdd

    return motion
