"""Rates with their uncertainty."""

from scipy.stats import binomtest


def wilson(hits: int, n: int) -> list[float]:
    """Return the 95 % Wilson interval of a rate, to four digits.

    Args:
        hits: How often it happened.
        n: Of how many; 0 gives [0, 1].
    """
    if n == 0:
        return [0.0, 1.0]
    interval = binomtest(hits, n).proportion_ci(method="wilson")
    return [round(float(interval.low), 4), round(float(interval.high), 4)]


def rate(hits: int, n: int) -> dict:
    """Return a rate with its count and its 95 % interval, as JSON can hold it."""
    value = hits / n if n else None
    return {"value": value, "hits": hits, "n": n, "interval": wilson(hits, n)}
