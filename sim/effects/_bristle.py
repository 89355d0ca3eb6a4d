"""Dry friction with memory: Dahl's bristle, driven by the true displacement."""

import numpy as np
from numba import njit

from residual.recording import Array


def deflection(x: Array, displacement: Array) -> Array:
    """Return the state of the bristles of several contacts, between -1 and 1.

    dz/dx = (1 - z sign(dx)) / displacement    (Dahl 1968, exponent 1)

    integrated exactly between samples: z goes to sign(dx) over some displacements and
    stays where it is at standstill, so that the torque of a joint at rest can be any
    value within its friction.

    Args:
        x: Relative positions of the two sides [rad]. Shape (n, k).
        displacement: Displacement over which a contact yields [rad]. Shape (k,).

    Returns:
        States, zero at the first sample. Shape (n, k).
    """
    return _dahl(
        np.ascontiguousarray(x, dtype=float), np.asarray(displacement, dtype=float)
    )


@njit(cache=True)
def _dahl(x, displacement):
    n, k = x.shape
    z = np.zeros((n, k))
    for i in range(1, n):
        for j in range(k):
            step = x[i, j] - x[i - 1, j]
            side = 1.0 if step >= 0 else -1.0
            rest = np.exp(-abs(step) / displacement[j])
            z[i, j] = side + (z[i - 1, j] - side) * rest
    return z
