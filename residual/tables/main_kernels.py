"""Compiled inner loop of main-effect tables; apart, since numba is slow to load."""

from numba import njit


@njit(cache=True)
def count_pairs(codes, starts, weight, totals, count, sums):
    """Fill the upper triangle of Z'Z, and Z'Y, from cells and their sums."""
    for c in range(codes.shape[0]):
        for i in range(codes.shape[1]):
            a = starts[i] + codes[c, i]
            for m in range(totals.shape[1]):
                sums[a, m] += totals[c, m]
            for j in range(i, codes.shape[1]):
                count[a, starts[j] + codes[c, j]] += weight[c]
