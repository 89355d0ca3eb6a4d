"""Few support points of a curve, so that lines between them follow it closely."""

from collections.abc import Callable

import numpy as np

from residual.recording import Array

DENSE = 4001  # points that the curve is looked at
ENOUGH = 1e-3  # of the largest value: more points help no controller


def support_points(
    curve: Callable[[Array], Array], start: Array, most: int
) -> tuple[Array, Array, float]:
    """Return support points of a curve, and the largest error between them.

    A point is added where the lines miss most, until they miss by next to nothing.

    Args:
        curve: Values at given places. Shape (n,) -> (n,).
        start: Places to begin with, increasing; the ends of the range among them.
        most: How many points at most.

    Returns:
        Places and values, shapes (k,), and the largest error of linear interpolation.
    """
    ends = np.linspace(start[0], start[-1], DENSE)
    # What happens near zero is narrow.
    near = np.concatenate([-np.geomspace(1e-5, 1, DENSE), np.geomspace(1e-5, 1, DENSE)])
    size = max(abs(start[0]), abs(start[-1]))
    inside = near[(near * size > start[0]) & (near * size < start[-1])] * size
    x = np.unique(np.concatenate([ends, inside, start]))
    y = curve(x)
    points = np.unique(start)
    while True:
        gap = np.abs(np.interp(x, points, np.interp(points, x, y)) - y)
        worst = int(np.argmax(gap))
        if len(points) >= most or gap[worst] <= ENOUGH * np.abs(y).max():
            return points, np.interp(points, x, y), float(gap.max())
        points = np.sort(np.append(points, x[worst]))
