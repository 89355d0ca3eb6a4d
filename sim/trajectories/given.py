"""A Fourier motion by its numbers: written down, read back, and the same again.

So can a motion be given that no search would end with: a slow one.
"""

from collections.abc import Sequence

import numpy as np

from residual.errors import InputError
from residual.robot.robot import Robot
from sim.trajectories.curves import Series, peaks
from sim.trajectories.fourier import (
    FREE,
    arena,
    draw,
    fit_in,
    free_of,
    harmonics,
    shrunk,
)

DIGITS = 9  # of a number that is written down [rad]
_TRIES = 50  # slow motions that are drawn at most


def written(series: Series) -> tuple[tuple[float, ...], ...]:
    """Return the coefficients of a series at rest at its ends, rounded.

    Returns:
        Centre, then the free coefficients: 9 rows of dof numbers [rad].
    """
    rows = np.vstack([series.centre, free_of(series)]).round(DIGITS) + 0.0
    return tuple(tuple(row) for row in rows.tolist())


def given(rows: Sequence[Sequence[float]], dof: int, period: float) -> Series:
    """Return the series of such coefficients.

    Args:
        period: Length of one period [s].

    Raises:
        InputError: If they are not finite numbers of that shape.
    """
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
        period: Length of one period [s].
        speed: What no joint is faster than [rad/s].

    Raises:
        InputError: If no motion that keeps the limits is found.
    """
    place = arena(robot, period)
    for _ in range(_TRIES):
        series = draw(place, rng)
        slow = shrunk(series, np.minimum(1.0, speed / peaks(series)[1]))
        fitted = fit_in(place, slow)
        if fitted is not None:
            return written(fitted)
    raise InputError(f"fourier: found no motion of {robot.name} below {speed:g} rad/s.")
