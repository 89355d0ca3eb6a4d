"""Motions that are short Fourier series, started and stopped gently."""

from dataclasses import dataclass

import numpy as np

from sim.synthetic.room import Room, draw_centre

Array = np.ndarray

_RAMP = 1.0  # s from rest to full speed, and back at the end
_RAMP_PEAK = 1.875 / _RAMP  # largest rate of the path speed [1/s]


@dataclass(frozen=True, eq=False, slots=True)
class Series:
    """q(s) = centre + sum_k sine_k sin(k w s) + cosine_k cos(k w s), w = 2 pi / period.

    Attributes:
        centre: Middle of the motion [rad]. Shape (dof,).
        sine: Coefficients of harmonics 1 to h [rad]. Shape (h, dof).
        cosine: Coefficients of harmonics 1 to h [rad]. Shape (h, dof).
        period: Length of one period [s].
    """

    centre: Array
    sine: Array
    cosine: Array
    period: float


def draw_fourier(space: Room, duration: float, rng: np.random.Generator) -> Series:
    """Draw five harmonics; two periods fit into the duration."""
    dof = len(space.centre)
    order = np.arange(1, 6)[:, None]
    sine, cosine = rng.normal(size=(2, 5, dof)) / order
    period = (duration - _RAMP) / 2
    return _within(space, Series(draw_centre(space, rng), sine, cosine, period), 1.0)


def draw_cyclic(
    space: Room, period: float, share: float, rng: np.random.Generator
) -> Series:
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
    series = Series(draw_centre(space, rng), sine, cosine, period)
    return _within(space, series, share)


def evaluate(series: Series, t: Array, duration: float) -> tuple[Array, Array, Array]:
    """Return positions, velocities and accelerations at the times t.

    The path time s(t) starts and ends at rest: q = q(s), qd = q' s', and
    qdd = q'' s'^2 + q' s''.
    """
    s, sd, sdd = path_time(t, duration)
    q, first, second = (derivative(series, s, d) for d in range(3))
    sd, sdd = sd[:, None], sdd[:, None]
    return series.centre + q, first * sd, second * sd**2 + first * sdd


def peaks(series: Series) -> tuple[Array, Array, Array]:
    """Return bounds of |q - centre|, |q'| and |q''| that hold for every s. (dof,)."""
    s = np.linspace(0, series.period, 400)
    size = np.hypot(series.sine, series.cosine)
    rate = 2 * np.pi / series.period * np.arange(1, len(size) + 1)[:, None]
    step = s[1] - s[0]

    def largest(times: int) -> Array:
        # Between two grid points a curve exceeds them by at most h^2/8 max|f''|.
        bend = (size * rate ** (times + 2)).sum(axis=0)
        grid = np.abs(derivative(series, s, times)).max(axis=0)
        return grid + step**2 / 8 * bend

    position, velocity, acceleration = (largest(d) for d in range(3))
    return position, velocity, acceleration


def derivative(series: Series, s: Array, times: int) -> Array:
    """Return the d-th derivative of q - centre with respect to s. Shape (n, dof)."""
    rate = 2 * np.pi / series.period * np.arange(1, len(series.sine) + 1)
    angle = np.outer(s, rate) + times * np.pi / 2
    factor = rate[:, None] ** times
    return np.sin(angle) @ (factor * series.sine) + np.cos(angle) @ (
        factor * series.cosine
    )


def _within(space: Room, series: Series, share: float) -> Series:
    """Scale each joint as large as its range (times share), speed and acceleration."""
    position, velocity, acceleration = peaks(series)
    scale = np.min(
        [
            share * space.amplitude / position,
            space.velocity / velocity,
            space.acceleration / (acceleration + _RAMP_PEAK * velocity),
        ],
        axis=0,
    )
    return Series(
        series.centre, scale * series.sine, scale * series.cosine, series.period
    )


def path_time(
    t: Array, duration: float, ramp: float = _RAMP
) -> tuple[Array, Array, Array]:
    """Return s, s' and s'': s' rises over one ramp by 10x^3 - 15x^4 + 6x^5.

    Args:
        t: Time from the start [s]. Shape (n,).
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
