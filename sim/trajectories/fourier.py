"""Exciting motion: five harmonics per joint, at rest at both ends of every period.

q(t) = a0 + sum_k a_k cos(k w t) + b_k sin(k w t)    (G2017 eq. 4)

with sum_k k b_k = 0 and sum_k k^2 a_k = 0, so that speed and acceleration are zero
wherever a period begins. Each joint moves as far as its range, speed and acceleration
let it (eq. 5), which are bounded over the whole period and not only at samples.

A motion may also be given by its numbers, written down, read back, and the same again:
so can one be given that no search would end with, a slow one.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import null_space

from residual.errors import InputError
from residual.recording import Array
from residual.robot.robot import Robot
from sim.engine.geometry import MARGIN, clearances
from sim.plant.sizes import draw_centre, usual_limits
from sim.trajectories.curves import Series, derivative, peaks
from sim.trajectories.limits import Workspace, between, largest_torque, workspace

HARMONICS = 5
FREE = 2 * (HARMONICS - 1)  # coefficients of a joint that rest at the ends leaves
_ORDER = np.arange(1, HARMONICS + 1)[:, None]
# b_k = beta_k / k and a_k = alpha_k / k^2, where the beta and the alpha add up to zero.
_BALANCED = null_space(np.ones((1, HARMONICS)))
_LEAST = 0.3  # a motion that must be made smaller than that is dropped
_SHRINK = 0.96
_KEPT = 0.998  # of the limits, for what coarser bounds add
_GRID = 400  # samples of a period that torque and clearance are taken at
_FEW = 10  # each of so many of them is looked at first
_TRIES = 100
_APART = 0.6  # of half of the range, where a centre may lie
DIGITS = 9  # of a number that is written down [rad]
_SLOW_TRIES = 50  # slow motions that are drawn at most


def harmonics(free: Array) -> tuple[Array, Array]:
    """Return sines and cosines at rest at t = 0. Shapes (8, dof) to 2 x (5, dof)."""
    half = HARMONICS - 1
    return _BALANCED @ free[:half] / _ORDER, _BALANCED @ free[half:] / _ORDER**2


def free_of(series: Series) -> Array:
    """Return what `harmonics` made a series of. Shape (8, dof)."""
    first, second = series.sine * _ORDER, series.cosine * _ORDER**2
    return np.vstack([_BALANCED.T @ first, _BALANCED.T @ second])


def sampled(series: Series, t: Array) -> tuple[Array, Array, Array]:
    """Return positions, velocities and accelerations of a series. Shapes (n, dof)."""
    q, qd, qdd = (derivative(series, t, d) for d in range(3))
    return series.centre + q, qd, qdd


def draw(place: Workspace, rng: np.random.Generator) -> Series:
    """Draw a random motion, made as large as the limits let it."""
    for number in range(_TRIES):
        # Around the zero posture first, and anywhere where that is a bad place.
        series = draw_any(place, rng, anywhere=number >= _TRIES // 2)
        fitted = fit_in(place, series)
        if fitted is not None:
            return fitted
    raise InputError(
        f"fourier: found no motion of {place.robot.name} that stays clear of the floor "
        "and itself within its torque. Check effort limits and geometry of the URDF."
    )


def draw_any(place: Workspace, rng: np.random.Generator, anywhere: bool) -> Series:
    """Draw a motion that only keeps range, speed and acceleration.

    Args:
        anywhere: Whether its centre may lie anywhere in the range; else it is up to
            0.3 rad off the zero posture, or what is near to that.
    """
    limits = place.limits
    free = rng.normal(size=(FREE, place.robot.dof))
    near = draw_centre(usual_limits(place.robot), rng)
    far = limits.middle + rng.uniform(-_APART, _APART, len(near)) * limits.half
    centre = far if anywhere else near
    return largest(place, Series(centre, *harmonics(free), place.period))


def largest(place: Workspace, series: Series) -> Series:
    """Scale every joint to the end of its range, speed or acceleration."""
    return shrunk(series, room_left(place, series))


def room_left(place: Workspace, series: Series) -> Array:
    """Return by what factor each joint may still grow about its centre. (dof,)."""
    limits = place.limits
    position, velocity, acceleration = peaks(series)
    q = derivative(series, np.arange(_GRID) / _GRID * place.period, 0)
    # What the bound of |q - centre| adds to the grid may be on either side.
    beyond = position - np.abs(q).max(axis=0)
    shares = [
        (limits.upper - series.centre) / (q.max(axis=0) + beyond),
        (series.centre - limits.lower) / (beyond - q.min(axis=0)),
        limits.velocity / velocity,
        limits.acceleration / acceleration,
    ]
    return np.clip(np.min(shares, axis=0) * _KEPT, 0.0, None)


def shrunk(series: Series, scale: Array | float) -> Series:
    """Return the series with a motion of another size about the same centre."""
    return replace(series, sine=scale * series.sine, cosine=scale * series.cosine)


def fit_in(place: Workspace, series: Series) -> Series | None:
    """Make a motion so much smaller that it keeps all limits, those of bodies too."""
    series = shrunk(series, np.minimum(room_left(place, series), 1.0))
    t, size = np.arange(_GRID) / _GRID * place.period, 1.0
    while size > _LEAST:
        smaller = shrunk(series, size)
        # Few samples tell most of what is wrong; all of them are needed for a yes.
        few = _free(place, smaller, t[::_FEW], False)
        if few and _free(place, smaller, t, True):
            return smaller
        size *= _SHRINK
    return None


def _free(place: Workspace, series: Series, t: Array, fully: bool) -> bool:
    """Say whether torque and clearance hold at some times, and fully: between them."""
    motion = sampled(series, t)
    torque = largest_torque(place.robot, *motion)
    space = clearances(place.arm, motion[0])
    if fully:
        torque = torque + between(torque)
        space = space - between(space)
    return bool((torque <= place.limits.torque).all() and (space >= MARGIN).all())


def written(series: Series) -> tuple[tuple[float, ...], ...]:
    """Return the coefficients of a series at rest at its ends, rounded.

    Returns:
        Centre, then the free coefficients: 9 rows of dof numbers [rad].
    """
    rows = np.vstack([series.centre, free_of(series)]).round(DIGITS) + 0.0
    return tuple(tuple(row) for row in rows.tolist())


def from_coefficients(
    rows: Sequence[Sequence[float]], dof: int, period: float
) -> Series:
    """Return the series of such coefficients."""
    shapes = {len(row) for row in rows}
    if len(rows) != 1 + FREE or shapes != {dof}:
        raise InputError(
            f"coefficients: expected {1 + FREE} rows of {dof} numbers, got "
            f"{len(rows)} rows of {', '.join(str(n) for n in sorted(shapes))}."
        )
    values = np.array(rows, dtype=float)
    if not np.isfinite(values).all():
        raise InputError("coefficients: expected finite numbers.")
    return Series(values[0], *harmonics(values[1:]), period)


def draw_slow(
    robot: Robot, period: float, speed: float, rng: np.random.Generator
) -> tuple[tuple[float, ...], ...]:
    """Draw a motion that creeps, for friction that lives at low speed.

    Args:
        speed: What no joint is faster than [rad/s].
    """
    place = workspace(robot, period)
    for _ in range(_SLOW_TRIES):
        series = draw(place, rng)
        slow = shrunk(series, np.minimum(1.0, speed / peaks(series)[1]))
        fitted = fit_in(place, slow)
        if fitted is not None:
            return written(fitted)
    raise InputError(f"fourier: found no motion of {robot.name} below {speed:g} rad/s.")
