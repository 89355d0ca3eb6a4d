"""Iteratively reweighted least squares: rows that fit badly weigh less.

u = r / s_j, with s_j the joint's noise by the median absolute residual;
Huber: weight min(1, k / |u|), k = 1.345; bisquare: (1 - (u / c)^2)^2 inside |u| < c,
c = 4.685 (Huber 1981; Holland and Welsch 1977: both lose 5 % on Gaussian noise).
"""

import numpy as np

from residual.identification import solve
from residual.identification.solve import Start
from residual.identification.structure import Rows
from residual.recording import Array

LOSSES = ("huber", "bisquare")
_K, _C = 1.345, 4.685
_MAD = 1.4826  # median absolute value to standard deviation, of Gaussian noise
_ROUNDS = 50


def reweighted(
    rows: Rows, start: Start, known: tuple[Array, Array], loss: str
) -> tuple[Array, Array, tuple[Array, ...]]:
    """Fit until weights and parameters agree.

    Args:
        rows: The rows.
        start: Start, free parameters and prior.
        known: Parameters to start from and autocorrelation time of each joint.
        loss: "huber" or "bisquare"; the latter starts from the former.

    Returns:
        Parameters (b,), noise of each joint [N m] (dof,), weights of rows (m_j,) each.
    """
    theta, memory = known
    if loss == "bisquare":
        theta, _, _ = reweighted(rows, start, known, "huber")
    for _ in range(_ROUNDS):
        left = solve.residuals(rows, theta)
        noise = _noise(left, rows)
        weights = tuple(_weight(r / s, loss) for r, s in zip(left, noise, strict=True))
        blocks = solve.compress(rows, weights)
        before = theta
        theta = solve.solve(blocks, 1 / (noise**2 * memory), start)
        if np.all(np.abs(theta - before) <= 1e-7 * start.size):
            break
    return theta, noise, weights


def shape(rows: Rows, theta: Array, noise: Array, loss: str) -> Array:
    """Mean psi' and mean psi^2 of each joint's standardised residuals. (2, dof).

    They turn the covariance of least squares into that of the robust fit.
    """
    out = np.ones((2, len(noise)))
    for j, (r, s) in enumerate(zip(solve.residuals(rows, theta), noise, strict=True)):
        if len(r) == 0:
            continue
        u = r / s
        out[1, j] = np.mean((_weight(u, loss) * u) ** 2)
        if loss == "huber":
            slope = np.abs(u) <= _K
        else:
            v = (u / _C) ** 2
            slope = np.where(v < 1, (1 - v) * (1 - 5 * v), 0.0)
        out[0, j] = max(np.mean(slope), 0.05)
    return out


def _noise(left: tuple[Array, ...], rows: Rows) -> Array:
    floor = 1e-7 * max(rows.rms.max(), 1e-9)
    middle = [np.median(np.abs(r)) if len(r) else 0.0 for r in left]
    return np.maximum(_MAD * np.array(middle), floor)


def _weight(u: Array, loss: str) -> Array:
    size = np.abs(u)
    if loss == "huber":
        return np.minimum(1.0, _K / np.maximum(size, _K))
    return np.where(size < _C, (1 - (size / _C) ** 2) ** 2, 0.0)
