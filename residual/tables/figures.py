"""What the paper's figures show of a fit: importance of variables, and odd rows.

A pair table also holds main effects of its two variables. They are taken out first
(weighted two-way analysis of variance) and credited to the variables: what is left is
what only a table of both can say. Over random rows every row left out has a neighbour
that stays, and almost any cell looks significant; over runs the motion itself is left
out.

Rows are odd by distance in the model, off the model, and in the response: T^2 is the
distance within the components, the squared prediction error (SPE, or Q) the distance
from them (paper, eq. 23: e_i), the y-residual f_i (eq. 27) the miss.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri, fdtri, ndtri, stdtrit

from residual.recording import Array
from residual.tables.crossval import as_block, as_pair, check_count, frozen
from residual.tables.lookup import Lookup, Table
from residual.tables.nominal_pls import NominalPls

UNSURE = 0.05
ALPHA = 0.01  # share of good rows that a limit calls outliers
STANDING, SLOW = 0.02, 0.3  # of the 95 % quantile of a joint's speed
CLASSES = ("standing", "slow", "fast")
MAD = 1.4826  # of a normal distribution: its sd per median absolute deviation


def table_importance(lookup: Lookup, X: Array) -> dict[str, Array]:
    """Return the size of each term's contribution about its mean on rows X (n, d).

    Variables in order, then every pair that has a table, as "q2 * qd3": [N m], (j,).
    """
    X = as_block(X, "X")
    level = [a.edges.searchsorted(X[:, a.variable], side="right") for a in lookup.axes]
    main = {v: X[:, [v]] * lookup.slope[v] for v in range(len(lookup.names))}
    pairs: dict[tuple[int, ...], Array] = {}
    for table in lookup.tables:
        variables = tuple(lookup.axes[a].variable for a in table.axes)
        at = [level[a] for a in table.axes]
        if len(variables) == 1:
            main[variables[0]] = main[variables[0]] + table.values[at[0]]
            continue
        *own, both = split_pair(table, *at)
        for variable, effect, k in zip(variables, own, at, strict=True):
            main[variable] = main[variable] + effect[k]
        pairs[variables] = pairs.get(variables, 0.0) + both[at[0], at[1]]
    parts = {(v,): part for v, part in main.items()} | pairs
    return {
        " * ".join(lookup.names[v] for v in variables): part.std(axis=0)
        for variables, part in parts.items()
    }


def split_pair(table: Table, first: Array, second: Array) -> tuple[Array, ...]:
    """Split a pair table into two main effects and what only both can say.

    min over r, c of the sum over rows of (v_ab - r_a - c_b)^2, level by level, given
    the levels of the rows on either axis.

    Returns:
        r, c and v - r - c; they add up to the table. Shapes (k1, j), (k2, j) and
        (k1, k2, j). The last is zero in a cell without rows.
    """
    rows, columns = table.values.shape[:2]
    count = np.bincount(first * columns + second, minlength=rows * columns)
    N = count.reshape(rows, columns).astype(float)
    weighted = table.values * N[..., None]
    system = np.block([[np.diag(N.sum(1)), N], [N.T, np.diag(N.sum(0))]])
    right = np.concatenate([weighted.sum(axis=1), weighted.sum(axis=0)])
    # The two constants are not told apart, and empty levels not at all: least norm.
    solved = np.linalg.lstsq(system, right, rcond=1e-12)[0]
    r, c = solved[:rows], solved[rows:]
    both = table.values - r[:, None] - c[None]
    return r, c, np.where(N[..., None] > 0, both, 0.0)


@dataclass(frozen=True, eq=False, slots=True)
class Jackknife:
    """Fitted numbers with their jack-knife standard errors."""

    values: Array  # fit to all rows. Any shape
    errors: Array  # standard errors, in the same units. Same shape
    groups: int  # groups left out, one at a time

    @property
    def significant(self) -> Array:
        """Whether |t| exceeds the two-sided 5 % limit of Student's t. Same shape."""
        limit = stdtrit(self.groups - 1, 1 - UNSURE / 2)
        return np.abs(self.values) > limit * self.errors


def jackknife(left_out: Array, full: Array) -> Jackknife:
    """Return standard errors from fits (G, ...) that leave one group out each.

    s^2 = (G - 1) / G sum_g (b_g - b)^2    (Martens and Martens 2001)
    """
    left_out, full = np.asarray(left_out, float), np.asarray(full, float)
    groups = check_count(len(left_out), 2, 2**62, "groups", "Take more runs.")
    spread = ((left_out - full) ** 2).sum(axis=0)
    errors = np.sqrt((groups - 1) / groups * spread)
    return Jackknife(frozen(full.copy()), frozen(errors), groups)


@dataclass(frozen=True, eq=False, slots=True)
class Distances:
    """Distances of rows with their limits."""

    # Shapes (n,). Dimensionless.
    t2: Array
    spe: Array
    # What 99 % of the calibration rows would keep.
    t2_limit: float
    spe_limit: float
    y: Array  # miss of each response in robust standard deviations, (n, j)
    y_limit: float  # what 99 % of normal rows would keep

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
    return float(factor * fdtri(components, rows - components, 1 - alpha))


def spe_limit(spe: Array, alpha: float = ALPHA) -> float:
    """Limit of SPE: g chi^2(h) with the calibration mean and variance (Box 1954)."""
    mean, variance = float(np.mean(spe)), float(np.var(spe))
    if mean <= 0 or variance <= 0:
        return mean
    return variance / (2 * mean) * float(chdtri(2 * mean**2 / variance, alpha))


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
    spe = np.maximum(spe, 0)
    miss = Y - model.predict(X)
    sizes = robust_sizes(miss)
    if classes is not None:
        for j, own in enumerate(classes.T):
            for one in np.unique(own):
                rows = own == one
                sizes[rows, j] = robust_sizes(miss[rows, j : j + 1])[:, 0]
    return Distances(
        frozen(hotelling_t2(t, model.energy / (model.rows - 1))),
        frozen(spe),
        t2_limit(a, len(spe)),
        spe_limit(spe),
        frozen(sizes),
        float(-ndtri(ALPHA / 2)),
    )


def robust_sizes(miss: Array) -> Array:
    """Miss of each column in robust standard deviations about its median. (n, j)."""
    gap = np.abs(miss - np.median(miss, axis=0))
    scale = MAD * np.median(gap, axis=0)
    return gap / np.where(scale > 0, scale, np.inf)
