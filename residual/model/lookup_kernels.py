"""Compiled evaluation of a look-up; its arrays are as `pack` describes them."""

import numpy as np
from numba import njit

# NaN must stay NaN here: compared, it takes the first step, and no read goes astray.
# Places and levels are unsigned: a signed index is first asked whether it is negative.
_FAST = {"contract", "reassoc", "nsz"}


@njit(cache=True, fastmath=_FAST, inline="always")
def _levels(x, axes, grid, starts, edges, level):
    last = starts.shape[1] - 1
    for a in range(axes.shape[0]):
        value, first = x[axes[a, 0]], axes[a, 1]
        step = (value - grid[a, 0]) * grid[a, 1]
        at = starts[a, int(step) if 0 < step < last else (last if step > 0 else 0)]
        # The grid may be off by rounding: the edges decide.
        while value >= edges[first + at]:
            at += 1
        while at > 0 and value < edges[first + at - 1]:
            at -= 1
        level[a] = at


@njit(cache=True, fastmath=_FAST, inline="always")
def _add_up(x, level, places, linear, cells, out):
    # Four responses at a time: one wide read per table, sums kept in registers.
    joints = out.shape[0]
    for m in range(0, joints, 4):
        y0, y1, y2, y3 = (
            linear[0, m],
            linear[0, m + 1],
            linear[0, m + 2],
            linear[0, m + 3],
        )
        for t in range(places.shape[0]):
            z = places[t, 0] + level[places[t, 3]]
            z += level[places[t, 1]] * places[t, 4] + level[places[t, 2]] * places[t, 5]
            y0 += cells[z, m]
            y1 += cells[z, m + 1]
            y2 += cells[z, m + 2]
            y3 += cells[z, m + 3]
        for i in range(x.shape[0]):
            y0 += x[i] * linear[1 + i, m]
            y1 += x[i] * linear[1 + i, m + 1]
            y2 += x[i] * linear[1 + i, m + 2]
            y3 += x[i] * linear[1 + i, m + 3]
        out[m] = y0
        if m + 1 < joints:
            out[m + 1] = y1
        if m + 2 < joints:
            out[m + 2] = y2
        if m + 3 < joints:
            out[m + 3] = y3


@njit(cache=True, fastmath=_FAST)
def evaluate_rows(X, packed, out):
    """Write the correction of every row of X. Shapes (n, d), ..., (n, j)."""
    axes, grid, starts, edges, places, linear, cells = packed
    level = np.empty(axes.shape[0], np.uint64)
    for r in range(X.shape[0]):
        _levels(X[r], axes, grid, starts, edges, level)
        _add_up(X[r], level, places, linear, cells, out[r])
