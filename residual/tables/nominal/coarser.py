"""Cells that no row visited take what the coarser level says of them.

The paper's last section asks for "a pyramidal representation of nominal levels" where
the state space was not sampled. A pair table at half as many levels of either variable
has a cell for four; its value is the mean of those that rows visited. Where none of the
four was, the level above it is asked, up to the mean of the whole table.
"""

from dataclasses import replace

import numpy as np

from residual.recording import Array
from residual.tables.blocks import frozen
from residual.tables.nominal.pls import NominalPls


def fill_unvisited(model: NominalPls) -> NominalPls:
    """Return the model with weights in cells that no calibration row visited.

    Predictions of calibration rows stay as they are, and so do offsets: their share of
    such cells is zero.
    """
    sizes, start = model.levels.sizes, 0
    V = model.V.copy()
    for first, second in model.pairs:
        shape = (sizes[first], sizes[second])
        cells = slice(start, start + shape[0] * shape[1])
        start = cells.stop
        V[:, cells] = _filled(V[:, cells], model.x_mean[cells], shape)
    return replace(model, V=frozen(V))


def _filled(weights: Array, share: Array, shape: tuple[int, int]) -> Array:
    """Weights of one table, all cells. Shapes (A, k), (k,)."""
    out, empty = weights.copy(), share <= 0
    rows, columns = np.divmod(np.arange(len(share)), shape[1])
    width = 2
    while empty.any():
        across = -(-shape[1] // width)
        parent = rows // width * across + columns // width
        mass = np.bincount(parent, share)
        known = empty & (mass[parent] > 0)
        for a, own in enumerate(weights):
            sums = np.bincount(parent, own * share)
            out[a, known] = sums[parent[known]] / mass[parent[known]]
        empty &= ~known
        width *= 2
    return out
