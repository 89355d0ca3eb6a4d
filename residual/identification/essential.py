"""Essential parameters: drop what the logs do not need (Gautier, Janot 2013).

The parameter of the largest relative standard deviation is set to zero and the others
are fitted again, as long as that deviation is above a limit and the squares do not
grow by more than chance: F = (S_r - S) / d / (S / (n - p)). Rows are autocorrelated:
they count as in the weights, and p is spent of all of them alike.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import fdtri

from residual.identification import solve
from residual.identification.estimate import Estimate
from residual.identification.solve import Start
from residual.recording import Array

_LIMIT = 0.05  # relative sd that every parameter may keep
_CHANCE = 0.95


@dataclass(frozen=True, eq=False, slots=True)
class Essential:
    """The outcome of a reduction.

    Attributes:
        dropped: Parameters set to zero, in the order in which they went.
        start: Start of the fit of those that remain.
        f_value: F of all that was dropped together.
        f_limit: Its 95 % quantile.
    """

    dropped: tuple[int, ...]
    start: Start
    f_value: float
    f_limit: float


def reduce(
    blocks: tuple[Array, ...], start: Start, estimate: Estimate, every: int
) -> Essential:
    """Drop parameters one by one.

    Args:
        estimate: The full fit; its weights are kept.
    """
    weight = estimate.weight
    rows = float(estimate.independent.sum())
    least = float(weight @ solve.squares(blocks, estimate.theta))
    left = rows * max(1 - len(start.free) / every, 0.1)
    kept = Essential((), start, 0.0, float("nan"))
    theta = estimate.theta
    while len(kept.start.free) > 1:
        relative = _relative_sd(blocks, weight, kept.start, theta)
        if relative.max() <= _LIMIT:
            break
        worst = int(kept.start.free[np.argmax(relative)])
        value = kept.start.value.copy()
        value[worst] = 0.0
        free = kept.start.free[kept.start.free != worst]
        tried = replace(kept.start, value=value, free=free)
        theta = solve.solve(blocks, weight, tried)
        count = len(kept.dropped) + 1
        more = float(weight @ solve.squares(blocks, theta)) - least
        ratio = more / count / (least / left)
        limit = float(fdtri(count, left, _CHANCE))
        if ratio > limit:
            break
        kept = Essential((*kept.dropped, worst), tried, float(ratio), limit)
    return kept


def _relative_sd(
    blocks: tuple[Array, ...], weight: Array, start: Start, theta: Array
) -> Array:
    """Relative sd of the free parameters under the weights. Shape (k,)."""
    size = start.size[start.free]
    pick = np.ix_(start.free, start.free)
    scaled = solve.gram(blocks, weight)[pick] * np.outer(size, size)
    covariance = np.linalg.pinv(scaled, rcond=1e-14, hermitian=True)
    sd = size * np.sqrt(np.maximum(np.diag(covariance), 0))
    return sd / np.maximum(np.abs(theta[start.free]), 1e-300)
