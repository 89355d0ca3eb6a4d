"""Rows that do not fit: by distance in the model, off the model, and in the response.

T^2 is the distance within the components, the squared prediction error (SPE, or Q) the
distance from them (paper, eq. 23: e_i), the y-residual f_i (eq. 27) the miss.
"""

from dataclasses import dataclass

import numpy as np
from scipy import stats

from residual.recording import Array
from residual.tables.blocks import as_pair, check_count, frozen
from residual.tables.nominal_pls import NominalPls

ALPHA = 0.01  # share of good rows that a limit calls outliers
STANDING, SLOW = 0.02, 0.3  # of the 95 % quantile of a joint's speed
CLASSES = ("standing", "slow", "fast")
MAD = 1.4826  # of a normal distribution: its sd per median absolute deviation


@dataclass(frozen=True, eq=False, slots=True)
class Distances:
    """Distances of rows with their limits.

    Attributes:
        t2, spe: Shapes (n,). Dimensionless.
        t2_limit, spe_limit: What 99 % of the calibration rows would keep.
        y: Miss of each response in robust standard deviations. Shape (n, j).
        y_limit: What 99 % of normal rows would keep.
    """

    t2: Array
    spe: Array
    t2_limit: float
    spe_limit: float
    y: Array
    y_limit: float

    @property
    def x_outliers(self) -> Array:
        """Rows beyond the limit of T^2 or SPE. Shape (n,)."""
        return (self.t2 > self.t2_limit) | (self.spe > self.spe_limit)

    @property
    def y_outliers(self) -> Array:
        """Rows whose miss of any response is beyond the limit. Shape (n,)."""
        return (self.y > self.y_limit).any(axis=1)


def hotelling_t2(scores: Array, variance: Array) -> Array:
    """T^2_i = sum_a t_ia^2 / s_a^2. Shapes (n, a), (a,) to (n,)."""
    return (scores**2 / variance).sum(axis=1)


def t2_limit(components: int, rows: int, alpha: float = ALPHA) -> float:
    """Limit of T^2: A (n^2 - 1) / (n (n - A)) F(A, n - A)."""
    check_count(components, 1, rows - 1, "components", f"There are {rows} rows.")
    factor = components * (rows**2 - 1) / (rows * (rows - components))
    return float(factor * stats.f.isf(alpha, components, rows - components))


def spe_limit(spe: Array, alpha: float = ALPHA) -> float:
    """Limit of SPE: g chi^2(h) with the calibration mean and variance (Box 1954)."""
    mean, variance = float(np.mean(spe)), float(np.var(spe))
    if mean <= 0 or variance <= 0:
        return mean
    return variance / (2 * mean) * float(stats.chi2.isf(alpha, 2 * mean**2 / variance))


def speed_classes(speed: Array) -> Array:
    """Number of `CLASSES` that each speed [rad/s] is in. Shape (n, j).

    Residuals at standstill are of another size than those in motion: under one scale
    for all, every slow row is an outlier, or none.
    """
    size = np.abs(speed)
    usual = np.quantile(size, 0.95, axis=0)
    return (size > STANDING * usual).astype(int) + (size > SLOW * usual)


def nominal_distances(
    model: NominalPls, X: Array, Y: Array, classes: Array | None = None
) -> Distances:
    """Distances of calibration rows in the nominal form; no row of X is ever formed.

    SPE = x'x - 2 x'xbar + xbar'xbar - 2 t'P'(x - xbar) + t'P'P t: reads of tables. Each
    class (n, j) of responses and rows has a scale of its own.
    """
    X, Y = as_pair(X, Y)
    table = np.vstack([model.V, model.P, model.x_mean[None]])
    read = model.read(X, table.T) - table @ model.x_mean
    a = model.components
    t, onto, middle = read[:, :a], read[:, a : 2 * a], read[:, 2 * a]
    # x'x - 2 x'xbar + xbar'xbar, with x'xbar - xbar'xbar just read.
    length = len(model.pairs) - 2 * middle - model.x_mean @ model.x_mean
    spe = length - 2 * (t * onto).sum(axis=1)
    spe += ((t @ (model.P @ model.P.T)) * t).sum(axis=1)
    t2 = hotelling_t2(t, model.energy / (model.rows - 1))
    sizes = _by_class(Y - model.predict(X), classes)
    return _distances(t2, np.maximum(spe, 0), sizes, a)


def _by_class(miss: Array, classes: Array | None) -> Array:
    if classes is None:
        return robust_sizes(miss)
    out = np.empty_like(miss)
    for j, own in enumerate(classes.T):
        for one in np.unique(own):
            rows = own == one
            out[rows, j] = robust_sizes(miss[rows, j : j + 1])[:, 0]
    return out


def robust_sizes(miss: Array) -> Array:
    """Miss of each column in robust standard deviations about its median. (n, j)."""
    gap = np.abs(miss - np.median(miss, axis=0))
    scale = MAD * np.median(gap, axis=0)
    return gap / np.where(scale > 0, scale, np.inf)


def _distances(t2: Array, spe: Array, sizes: Array, components: int) -> Distances:
    return Distances(
        frozen(t2),
        frozen(spe),
        t2_limit(components, len(t2)),
        spe_limit(spe),
        frozen(sizes),
        float(stats.norm.isf(ALPHA / 2)),
    )
