"""Compiled loops: tables read at levels, and nominal-level PLS without its matrix.

Of a look-up the arrays are as `pack` describes them. X of the nominal form has a column
for every pair of levels of every pair of variables, and in each row a one per pair of
variables: X r reads a table there, X'u adds there. Columns are in the order of eq. 30
of the paper: pairs (1,2), (1,3) ..., within a pair the second level runs fastest.
"""

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


@njit(cache=True, fastmath=_FAST)
def evaluate_levels(levels, packed, out):
    """Write the correction at known levels, no slope. Shapes (n, a), ..., (n, j)."""
    _, _, _, _, places, linear, cells = packed
    nothing = np.empty(0)
    for r in range(levels.shape[0]):
        _add_up(nothing, levels[r], places, linear, cells, out[r])


@njit(cache=True, fastmath=_FAST)
def evaluate_row(x, packed, out):
    """Write the correction of one row. Shapes (d,), ..., (j,)."""
    axes, grid, starts, edges, places, linear, cells = packed
    level = np.empty(axes.shape[0], np.uint64)
    _levels(x, axes, grid, starts, edges, level)
    _add_up(x, level, places, linear, cells, out)


@njit(cache=True, fastmath=True)
def scatter_pairs(codes, sizes, values, out):
    """Add X'u to a table: out += X'u. Shapes (c, d), (d,), (c, f), (p, f)."""
    for c in range(codes.shape[0]):
        start = 0
        for i in range(codes.shape[1] - 1):
            for j in range(i + 1, codes.shape[1]):
                z = start + codes[c, i] * sizes[j] + codes[c, j]
                start += sizes[i] * sizes[j]
                for f in range(values.shape[1]):
                    out[z, f] += values[c, f]


@njit(cache=True, fastmath=True)
def gather_pairs(codes, sizes, table, out):
    """Read X r from a table: out = X r. Shapes (c, d), (d,), (p, f), (c, f)."""
    for c in range(codes.shape[0]):
        for f in range(table.shape[1]):
            out[c, f] = 0.0
        start = 0
        for i in range(codes.shape[1] - 1):
            for j in range(i + 1, codes.shape[1]):
                z = start + codes[c, i] * sizes[j] + codes[c, j]
                start += sizes[i] * sizes[j]
                for f in range(table.shape[1]):
                    out[c, f] += table[z, f]


@njit(cache=True, fastmath=True)
def soft(w, limit):
    """Bring a number closer to zero by a limit, and not beyond it."""
    if w > limit:
        return w - limit
    return w + limit if w < -limit else 0.0


@njit(cache=True, fastmath=True)
def aim(S, q, w, sparsity):
    """Write weights w = S'q / |S'q|; return |S'q|.

    Dayal and MacGregor, step 2, with S'q soft-thresholded at a share of its largest
    before (Chun and Keles 2010). Shapes (j, p), (j,), (p,), and a number.
    """
    largest, whole, norm = 0.0, 0.0, 0.0
    for z in range(S.shape[1]):
        w[z] = 0.0
        for m in range(S.shape[0]):
            w[z] += q[m] * S[m, z]
        whole += w[z] * w[z]
        largest = max(largest, abs(w[z]))
    for z in range(S.shape[1]):
        w[z] = soft(w[z], sparsity * largest)
        norm += w[z] * w[z]
    if norm > 0.0:
        for z in range(S.shape[1]):
            w[z] /= norm**0.5
    return whole**0.5


@njit(cache=True, fastmath=True)
def turn(W, V, P, a):
    """Write v = w - V (P'w) of component a (Dayal and MacGregor, step 3). (A, p)."""
    for z in range(W.shape[1]):
        V[a, z] = W[a, z]
    for b in range(a):
        share = 0.0
        for z in range(W.shape[1]):
            share += P[b, z] * W[a, z]
        for z in range(W.shape[1]):
            V[a, z] -= share * V[b, z]


@njit(cache=True, fastmath=True)
def score(codes, sizes, count, v, middle, p):
    """Add X'(n t) to p for t = X v - middle; return sum n t^2 and sum n t.

    Step 4 without forming t: every cell is read once. Shapes (c, d), (d,), (c,), (p,),
    a number, (p,).
    """
    places = codes.shape[1] * (codes.shape[1] - 1) // 2
    energy, total = 0.0, 0.0
    at = np.empty(places, np.int64)
    for c in range(codes.shape[0]):
        start, g, t = 0, 0, -middle
        for i in range(codes.shape[1] - 1):
            for j in range(i + 1, codes.shape[1]):
                z = start + codes[c, i] * sizes[j] + codes[c, j]
                start += sizes[i] * sizes[j]
                t += v[z]
                at[g] = z
                g += 1
        weighted = count[c] * t
        energy += weighted * t
        total += weighted
        for g in range(places):
            p[at[g]] += weighted
    return energy, total


@njit(cache=True, fastmath=True)
def explain(S, v, p, middle, energy, total):
    """Finish loading p, return q, and take the component out of S = Y'X.

    Step 4 and 5: p = (X'(n t) - xbar sum(n t)) / t't, q = S v / t't, S -= t't q p'.
    Shapes (j, p), (p,), (p,), (p,).
    """
    for z in range(p.shape[0]):
        p[z] = (p[z] - middle[z] * total) / energy
    q = S[:, 0] * 0.0
    for m in range(S.shape[0]):
        for z in range(S.shape[1]):
            q[m] += S[m, z] * v[z]
        q[m] /= energy
        for z in range(S.shape[1]):
            S[m, z] -= energy * q[m] * p[z]
    return q


@njit(cache=True, fastmath=True)
def directions(S, q, W, sparsity):
    """Write w = S'q / |S'q| of every fold, thresholded as by `aim`; return |S'q|.

    Shapes (j, p, F), (F, j), (p, F), and a number.
    """
    _, places, width = S.shape
    norm, largest, kept = np.zeros(width), np.zeros(width), np.zeros(width)
    for z in range(places):
        for f in range(width):
            w = 0.0
            for m in range(S.shape[0]):
                w += q[f, m] * S[m, z, f]
            W[z, f] = w
            norm[f] += w * w
            largest[f] = max(largest[f], abs(w))
    for z in range(places):
        for f in range(width):
            W[z, f] = soft(W[z, f], sparsity * largest[f])
            kept[f] += W[z, f] ** 2
    norm, kept = np.sqrt(norm), np.sqrt(kept)
    for f in range(width):
        inverse = 1 / kept[f] if kept[f] > 0 else 0.0
        for z in range(places):
            W[z, f] *= inverse
    return norm


@njit(cache=True, fastmath=True)
def orthogonalise(T, energy, count, a):
    """Take earlier scores out of t_a, in every fold's weights.

    In place of v = w - V (P'w): scores of cells are shorter than tables of weights.
    Shapes (A, c, F), (A, F), (c, F).
    """
    cells, width = count.shape
    for b in range(a):
        share = np.zeros(width)
        for c in range(cells):
            for f in range(width):
                share[f] += count[c, f] * T[a, c, f] * T[b, c, f]
        for f in range(width):
            share[f] /= energy[b, f]
        for c in range(cells):
            for f in range(width):
                T[a, c, f] -= share[f] * T[b, c, f]


@njit(cache=True, fastmath=True)
def deflate(S, P, middle, total, q):
    """Take a component out of S = Y'X: S -= q (X'(n t) - xbar sum(n t))'.

    Shapes (j, p, F), (p, F), (p, F), (F,), (j, F).
    """
    for z in range(P.shape[0]):
        for f in range(P.shape[1]):
            p = P[z, f] - middle[z, f] * total[f]
            for m in range(S.shape[0]):
                S[m, z, f] -= q[m, f] * p
