"""Least squares over the rows of all joints, without ever squaring them.

The rows of joint j are replaced by the triangle R_j of [x_j y_j] = Q_j R_j: as few
rows as columns, and the same least squares for every choice of columns and of the
weights w_j between joints:

min  sum_j w_j |x_j theta - y_j|^2 + (theta - theta_0)' L (theta - theta_0)
"""

from dataclasses import dataclass

import numpy as np

from residual.identification.structure import Rows
from residual.recording import Array

LAGS = 80
_CUT = 1e-10  # singular values below this share tell nothing: nominal stays


@dataclass(frozen=True, eq=False, slots=True)
class Start:
    """Where a fit starts, and what it may move.

    Attributes:
        value: theta_0: what stays if the rows tell nothing. Shape (b,).
        size: What counts as a large change of each. Shape (b,).
        free: Which may move. Shape (k,).
        precision: L over all parameters, None for a free fit. Shape (b, b).
    """

    value: Array
    size: Array
    free: Array
    precision: Array | None = None

    @property
    def root(self) -> Array:
        """Rows that stand for the prior, in units of size. Shape (k or 0, k)."""
        if self.precision is None:
            return np.zeros((0, len(self.free)))
        size = self.size[self.free]
        own = self.precision[np.ix_(self.free, self.free)] * np.outer(size, size)
        return np.linalg.cholesky(own).T


def compress(rows: Rows, weights: tuple[Array, ...] | None = None) -> tuple[Array, ...]:
    """Return R_j of every joint. Shapes (at most b + 1, b + 1).

    Args:
        weights: A weight of each row, or None. Shapes (m_j,).
    """
    out = []
    for j, (x, y) in enumerate(zip(rows.x, rows.y, strict=True)):
        both = np.column_stack([x, y])
        if weights is not None:
            both = both * np.sqrt(weights[j])[:, None]
        out.append(np.linalg.qr(both, mode="r"))
    return tuple(out)


def solve(blocks: tuple[Array, ...], weight: Array, start: Start) -> Array:
    """Return the parameters that minimise the weighted squares.

    Directions that no row speaks of stay where they start.

    Args:
        weight: w_j. Shape (dof,).

    Returns:
        Parameters. Shape (b,).
    """
    size, root = start.size[start.free], start.root
    stacked = np.concatenate(
        [np.sqrt(w) * r for w, r in zip(weight, blocks, strict=True)]
    )
    left = stacked[:, start.free] * size
    right = stacked[:, -1] - stacked[:, :-1] @ start.value
    left = np.concatenate([left, root])
    right = np.concatenate([right, np.zeros(len(root))])
    theta = start.value.copy()
    theta[start.free] += size * np.linalg.lstsq(left, right, rcond=_CUT)[0]
    return theta


def squares(blocks: tuple[Array, ...], theta: Array) -> Array:
    """Return |x_j theta - y_j|^2 of each joint [N^2 m^2]. Shape (dof,)."""
    both = np.append(theta, -1.0)
    return np.array([np.sum((r @ both) ** 2) for r in blocks])


def gram(blocks: tuple[Array, ...], weight: Array) -> Array:
    """Return sum_j w_j x_j' x_j. Shape (b, b)."""
    size = blocks[0].shape[1] - 1
    out = np.zeros((size, size))
    for w, r in zip(weight, blocks, strict=True):
        out += w * r[:, :-1].T @ r[:, :-1]
    return out


def condition(blocks: tuple[Array, ...], weight: Array, free: Array) -> float:
    """Return the condition number of the weighted, column-normalised rows."""
    pairs = zip(weight, blocks, strict=True)
    stacked = np.concatenate([np.sqrt(w) * r[:, free] for w, r in pairs])
    size = np.linalg.norm(stacked, axis=0)
    if len(free) == 0 or size.min() == 0:
        return float("inf")
    return float(np.linalg.cond(stacked / size))


def residuals(rows: Rows, theta: Array) -> tuple[Array, ...]:
    """Return y_j - x_j theta [N m]. Shapes (m_j,)."""
    return tuple(y - x @ theta for x, y in zip(rows.x, rows.y, strict=True))


def autocorrelation(rows: Rows, left: tuple[Array, ...]) -> Array:
    """Return how many rows tell as much as one independent row would, per joint.

    The integrated autocorrelation time of the residual, by initial positive pairs
    (Geyer 1992), over the time lines of the logs.

    Args:
        left: Their residuals. Shapes (m_j,).

    Returns:
        At least 1. Shape (dof,).
    """
    out = np.ones(len(left))
    for j, (values, series) in enumerate(zip(left, rows.series, strict=True)):
        acov = np.zeros(LAGS)
        for log in np.unique(series[:, 0]):
            own = series[:, 0] == log
            place = series[own, 1] - series[own, 1].min()
            line = np.zeros(place.max() + 1)
            line[place] = values[own]
            spectrum = np.fft.rfft(line, 2 * len(line))
            lags = np.fft.irfft(spectrum * spectrum.conj())[: min(LAGS, len(line))]
            acov[: len(lags)] += lags
        if acov[0] <= 0:
            continue
        rho = acov / acov[0]
        pairs = rho[1:-1:2] + rho[2::2]
        stop = int(np.argmax(pairs <= 0)) if (pairs <= 0).any() else len(pairs)
        out[j] = max(1.0, 1 + 2 * pairs[:stop].sum())
    return out
