"""A Fourier motion by its numbers: written down, read back, and the same again."""

from collections.abc import Sequence

import numpy as np

from residual.errors import InputError
from sim.synthetic.series import Series
from sim.trajectories.fourier import FREE, free_of, harmonics

Array = np.ndarray

DIGITS = 9  # of a number that is written down [rad]


def written(series: Series) -> tuple[tuple[float, ...], ...]:
    """Return the coefficients of a series at rest at its ends, rounded.

    Args:
        series: As `fourier.harmonics` makes it.

    Returns:
        Centre, then the free coefficients: 9 rows of dof numbers [rad].
    """
    rows = np.vstack([series.centre, free_of(series)]).round(DIGITS) + 0.0
    return tuple(tuple(row) for row in rows.tolist())


def given(rows: Sequence[Sequence[float]], dof: int, period: float) -> Series:
    """Return the series of such coefficients.

    Args:
        rows: As `written` returns them.
        dof: Number of joints.
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
