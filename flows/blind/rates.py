"""Rates with their uncertainty."""

import math


def wilson(hits: int, n: int) -> list[float]:
    """Return the 95 % Wilson interval of a rate.

    (p + z^2/2n -+ z sqrt(p(1-p)/n + z^2/4n^2)) / (1 + z^2/n), z = 1.96    (Wilson 1927)

    Args:
        hits: How often it happened.
        n: Of how many; 0 gives [0, 1].
    """
    if n == 0:
        return [0.0, 1.0]
    z, p = 1.96, hits / n
    middle = p + z * z / (2 * n)
    half = z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    low, high = ((middle + side * half) / (1 + z * z / n) for side in (-1, 1))
    return [round(max(0.0, low), 4), round(min(1.0, high), 4)]


def rate(hits: int, n: int) -> dict:
    """Return a rate with its count and its 95 % interval, as JSON can hold it."""
    value = hits / n if n else None
    return {"value": value, "hits": hits, "n": n, "interval": wilson(hits, n)}
