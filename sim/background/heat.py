"""Warmth of the joints over one motion of a synthetic arm."""

import numpy as np
from numba import njit

from sim.background.draw import Background

Array = np.ndarray


def warmth_after(background: Background, worked: float) -> Array:
    """Return the warmth of oil and housing after so long of usual work. (2, dof).

    Args:
        worked: Time of usual work since the arm was cold [s].
    """
    return 1.0 - np.exp(-worked / np.array([background.oil, background.housing]))


def warmths(start: Array, power: Array, times: Array, growth: Array) -> Array:
    """Return the warmth of oil and housing at every sample.

    The friction that heats is itself what has become less by the heat.

    Args:
        start: Warmth at the first sample. Shape (2, dof).
        power: Power of cold friction over the usual one. Shape (n, dof).
        times: Time constants of oil and housing in samples. Shape (2, dof).
        growth: Cold friction over warm one, less one. Shape (dof,).

    Returns:
        Warmth. Shape (2, n, dof).
    """
    return _warmths(start, np.ascontiguousarray(power), times, growth)


# One file with all it calls: numba keeps a function until its own file changes.
@njit(cache=True)
def _warmths(start, power, times, growth):
    n, dof = power.shape
    out = np.empty((2, n, dof))
    out[:, 0] = start
    for i in range(1, n):
        for j in range(dof):
            oil, housing = out[0, i - 1, j], out[1, i - 1, j]
            less = 1.0 / (1.0 + growth[j] * (0.4 * oil + 0.6 * housing))
            heat = max(0.0, power[i - 1, j]) * less
            out[0, i, j] = oil + (heat - oil) / times[0, j]
            out[1, i, j] = housing + (heat - housing) / times[1, j]
    return out
