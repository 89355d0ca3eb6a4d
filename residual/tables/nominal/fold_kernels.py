"""Compiled steps of kernel PLS on tables that are as wide as there are folds."""

import numpy as np
from numba import njit


@njit(cache=True, fastmath=True)
def directions(S, q, W):
    """Write w = S'q / |S'q| of every fold; return the lengths |S'q|.

    Shapes (j, p, F), (F, j), (p, F).
    """
    _, places, width = S.shape
    norm = np.zeros(width)
    for z in range(places):
        for f in range(width):
            w = 0.0
            for m in range(S.shape[0]):
                w += q[f, m] * S[m, z, f]
            W[z, f] = w
            norm[f] += w * w
    norm = np.sqrt(norm)
    for f in range(width):
        inverse = 1 / norm[f] if norm[f] > 0 else 0.0
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
