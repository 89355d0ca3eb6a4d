"""Compiled loops of the nominal-level PLSR, which never form its matrix.

X of the nominal form has a column for every pair of levels of every pair of variables,
and in each row a one per pair of variables: X r reads a table there, X'u adds there.
Columns are in the order of eq. 30 of the paper: pairs (1,2), (1,3) ..., within a pair
the second level runs fastest.
"""

import numpy as np
from numba import njit


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
def compute_weight_vector(S, q, w):
    """Write weights w = S'q / |S'q|: Dayal and MacGregor, step 2.

    Shapes (j, p), (j,), (p,).
    """
    norm = 0.0
    for z in range(S.shape[1]):
        w[z] = 0.0
        for m in range(S.shape[0]):
            w[z] += q[m] * S[m, z]
    for z in range(S.shape[1]):
        norm += w[z] * w[z]
    if norm > 0.0:
        for z in range(S.shape[1]):
            w[z] /= norm**0.5


@njit(cache=True, fastmath=True)
def orthogonalize_weight_vector(W, V, P, a):
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
def accumulate_component_scores(codes, sizes, count, v, middle, p):
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
def deflate_by_component(S, v, p, middle, energy, total):
    """Finish loading p, return q, and deflate S = Y'X by the component.

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
