"""One fit of the rows, by the method asked for, with its covariance.

- ols: every row of every joint weighs the same;
- wls: a joint weighs by its noise, w_j = 1 / (s_j^2 t_j), with s_j the standard
  deviation of its residual and t_j the autocorrelation time of it;
- irls: also each row by its own residual u = r / s_j, with s_j the joint's noise by the
  median absolute residual: weight min(1, k / |u|), k = 1.345 (Huber 1981: 5 % are lost
  on Gaussian noise).

The covariance is the sandwich B M B, B = (sum w_j x'x + L)^-1, M = sum w_j^2 s_j^2 t_j
x'x + L, right for each of them as long as the model is.

Nothing is ever squared: the rows of joint j are replaced by the triangle R_j of
[x_j y_j] = Q_j R_j, the "blocks": as few rows as columns, and the same least squares
for every choice of columns and of the weights w_j between joints:

min  sum_j w_j |x_j theta - y_j|^2 + (theta - theta_0)' L (theta - theta_0)
"""

from dataclasses import dataclass, replace

import numpy as np

from residual.errors import InputError, check_name
from residual.evidence.design import LAGS
from residual.evidence.fit import estimate_autocorrelation_time
from residual.identification.observability import JointRows
from residual.recording import Array

METHODS = ("ols", "wls", "irls")
_CUT = 1e-10  # singular values below this share tell nothing: nominal stays
_FLOOR = 1e-7  # of torque rms: noise of logs that have none
_ROUNDS, _REWEIGHTINGS = 20, 50
_K = 1.345
_MAD = 1.4826  # median absolute value to standard deviation, of Gaussian noise

Blocks = tuple[Array, ...]


@dataclass(frozen=True, slots=True)
class Options:
    """How to identify.

    Attributes:
        method: "ols", "wls" or "irls".
        prior: Relative scale of a Gaussian prior about the nominal, None for a free
            fit.
    """

    method: str = "wls"
    prior: float | None = None

    def __post_init__(self) -> None:
        check_name(self.method, METHODS, "method")
        if self.prior is not None and not 0 < self.prior < np.inf:
            raise InputError(
                f"Prior scale {self.prior:g}: expected a positive number such as 0.03, "
                "the share by which nominal values may be off."
            )


@dataclass(frozen=True, eq=False, slots=True)
class FitStart:
    """Where a fit starts, and what it may move."""

    value: Array  # theta_0: what stays if the rows tell nothing, (b,)
    size: Array  # what counts as a large change of each, (b,)
    free: Array  # which may move, (k,)
    precision: Array | None = None  # l over all parameters, None for a free fit, (b, b)

    @property
    def prior(self) -> Array:
        """L of what may move, in units of size. Shape (k, k)."""
        size = self.size[self.free]
        if self.precision is None:
            return np.zeros((len(size), len(size)))
        return self.precision[np.ix_(self.free, self.free)] * np.outer(size, size)


@dataclass(frozen=True, eq=False, slots=True)
class Estimate:
    """One fit."""

    theta: Array  # base parameters [SI], (b,)
    covariance: Array  # of theta; 0 where held or dropped, (b, b)
    noise: Array  # standard deviation of each joint's residual [N m], (dof,)
    independent_rows: Array  # rows of each joint over their autocorrelation time, (dof,)
    weight: Array  # w_j, (dof,)
    condition: float  # condition number of the weighted, column-normalised rows
    outliers: Array  # share of each joint's rows that weigh less than half, (dof,)
    counts: Array  # rows of each joint, (dof,)
    row_weights: tuple[Array, ...] | None = None  # of irls, else None, (m_j,)

    @property
    def sd(self) -> Array:
        """Standard deviation of theta, 0 where it was not fitted. Shape (b,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def relative_sd(self) -> Array:
        """Standard deviation as a share of the value. Shape (b,)."""
        return self.sd / np.maximum(np.abs(self.theta), 1e-300)


def compress_joint_rows(rows: JointRows, weights: tuple[Array, ...] | None = None) -> Blocks:
    """Return R_j of every joint, (at most b + 1, b + 1), of rows or weighted rows."""
    out = []
    for j, (x, y) in enumerate(zip(rows.x, rows.y, strict=True)):
        both = np.column_stack([x, y])
        if weights is not None:
            both = both * np.sqrt(weights[j])[:, None]
        out.append(np.linalg.qr(both, mode="r"))
    return tuple(out)


def solve_least_squares(blocks: Blocks, joint_weights: Array, start: FitStart) -> Array:
    """Return the parameters that minimise the squares weighted by w_j. Shape (b,).

    Directions that no row speaks of stay where they start.
    """
    size = start.size[start.free]
    rows = stack_weighted_blocks(blocks, joint_weights)
    left = rows[:, start.free] * size
    right = rows[:, -1] - rows[:, :-1] @ start.value
    if start.precision is not None:
        left = np.concatenate([left, np.linalg.cholesky(start.prior).T])
        right = np.concatenate([right, np.zeros(len(size))])
    theta = start.value.copy()
    theta[start.free] += size * np.linalg.lstsq(left, right, rcond=_CUT)[0]
    return theta


def stack_weighted_blocks(blocks: Blocks, joint_weights: Array) -> Array:
    """Return the rows of all joints, by the roots of their weights."""
    pairs = zip(joint_weights, blocks, strict=True)
    return np.concatenate([np.sqrt(w) * block for w, block in pairs])


def sum_squared_residuals(blocks: Blocks, theta: Array) -> Array:
    """Return |x_j theta - y_j|^2 of each joint [N^2 m^2]. Shape (dof,)."""
    both = np.append(theta, -1.0)
    return np.array([np.sum((r @ both) ** 2) for r in blocks])


def compute_weighted_gram(blocks: Blocks, joint_weights: Array) -> Array:
    """Return sum_j w_j x_j' x_j. Shape (b, b)."""
    pairs = zip(joint_weights, blocks, strict=True)
    return sum(w * r[:, :-1].T @ r[:, :-1] for w, r in pairs)


def compute_condition_number(blocks: Blocks, joint_weights: Array, free_indices: Array) -> float:
    """Return the condition number of the weighted, column-normalised rows."""
    rows = stack_weighted_blocks(blocks, joint_weights)[:, free_indices]
    size = np.linalg.norm(rows, axis=0)
    if len(free_indices) == 0 or size.min() == 0:
        return float("inf")
    return float(np.linalg.cond(rows / size))


def compute_joint_residuals(rows: JointRows, theta: Array) -> tuple[Array, ...]:
    """Return y_j - x_j theta [N m]. Shapes (m_j,)."""
    return tuple(y - x @ theta for x, y in zip(rows.x, rows.y, strict=True))


def compute_autocorrelation_times(rows: JointRows, residual: tuple[Array, ...]) -> Array:
    """Return how many rows of residuals (m_j,) tell as much as one would. (dof,)."""
    out = np.ones(len(residual))
    for j, (values, series) in enumerate(zip(residual, rows.series, strict=True)):
        lines = []
        for log in np.unique(series[:, 0]):
            in_log = series[:, 0] == log
            place = series[in_log, 1] - series[in_log, 1].min()
            lines.append(np.zeros(place.max() + 1 + LAGS))
            lines[-1][place] = values[in_log]
        if lines:
            out[j] = estimate_autocorrelation_time(np.concatenate(lines))
    return out


def estimate_parameters(
    rows: JointRows, blocks: Blocks, start: FitStart, options: Options
) -> Estimate:
    """Fit rows, and the same compressed, by the method asked for, with covariance."""
    free = replace(start, precision=None)
    theta = solve_least_squares(blocks, np.ones(len(rows.y)), free)
    for _ in range(_ROUNDS):
        before = theta
        weight, noise, memory = compute_joint_weights(rows, theta, options.method, len(start.free))
        theta = solve_least_squares(blocks, weight, free)
        if np.all(np.abs(theta - before) <= 1e-9 * start.size):
            break
    # Noise is that of the free fit: a prior that binds would make its own misfit look
    # like noise, and bind the more.
    theta = solve_least_squares(blocks, weight, start)
    weights, means = None, np.ones((2, len(weight)))
    outliers = np.zeros(len(weight))
    if options.method == "irls":
        theta, noise, weights = fit_reweighted(rows, start, theta, memory)
        # Mean psi' and mean psi^2 of each joint's standardised residuals turn the
        # covariance of least squares into that of the robust fit.
        for j, (r, s) in enumerate(zip(compute_joint_residuals(rows, theta), noise, strict=True)):
            if len(r) == 0:
                continue
            u = r / s
            means[1, j] = np.mean((_weight(u) * u) ** 2)
            means[0, j] = max(np.mean(np.abs(u) <= _K), 0.05)
        weight = 1 / (noise**2 * memory)
        outliers = np.array([np.mean(w < 0.5) if len(w) else 0.0 for w in weights])
    # The sandwich, in units of size.
    size, pick = start.size[start.free], np.ix_(start.free, start.free)
    unit, prior = np.outer(size, size), start.prior
    meat = weight**2 * means[1] * noise**2 * memory
    inner = compute_weighted_gram(blocks, meat)[pick] * unit + prior
    outer = compute_weighted_gram(blocks, weight * means[0])[pick] * unit + prior
    inverse = np.linalg.pinv(outer, rcond=1e-14, hermitian=True)
    covariance = np.zeros((len(start.size), len(start.size)))
    covariance[pick] = inverse @ inner @ inverse * unit
    return Estimate(
        theta=theta,
        covariance=covariance,
        noise=noise,
        independent_rows=rows.counts / memory,
        weight=weight,
        condition=compute_condition_number(blocks, weight, start.free),
        outliers=outliers,
        counts=rows.counts,
        row_weights=weights,
    )


def compute_joint_weights(
    rows: JointRows, theta: Array, method: str, parameters: int = 0
) -> tuple[Array, Array, Array]:
    """Return weight w_j, noise s_j [N m] and autocorrelation time t_j of each joint.

    Args:
        method: "ols" gives all joints one weight.
        parameters: How many were fitted to these rows.
    """
    residual = compute_joint_residuals(rows, theta)
    memory = compute_autocorrelation_times(rows, residual)
    sse = np.array([np.sum(r**2) for r in residual])
    spent = max(1 - parameters / max(rows.counts.sum(), 1), 0.1)
    noise = np.sqrt(sse / np.maximum(rows.counts * spent, 1))
    noise = np.maximum(noise, _least_noise(rows))
    weight = 1 / (noise**2 * memory)
    if method == "ols":
        share = rows.counts / rows.counts.sum()
        weight = np.full(len(noise), 1 / (share @ (noise**2 * memory)))
    return weight, noise, memory


def _least_noise(rows: JointRows) -> float:
    return _FLOOR * max(rows.rms.max(), 1e-9)


def fit_reweighted(
    rows: JointRows, start: FitStart, theta: Array, autocorrelation_times: Array
) -> tuple[Array, Array, tuple[Array, ...]]:
    """Fit until weights and parameters agree.

    Returns:
        Parameters (b,), noise of each joint [N m] (dof,), weights of rows (m_j,) each.
    """
    for _ in range(_REWEIGHTINGS):
        residual = compute_joint_residuals(rows, theta)
        middle = [np.median(np.abs(r)) if len(r) else 0.0 for r in residual]
        noise = np.maximum(_MAD * np.array(middle), _least_noise(rows))
        weights = tuple(_weight(r / s) for r, s in zip(residual, noise, strict=True))
        before = theta
        theta = solve_least_squares(
            compress_joint_rows(rows, weights), 1 / (noise**2 * autocorrelation_times), start
        )
        if np.all(np.abs(theta - before) <= 1e-7 * start.size):
            break
    return theta, noise, weights


def _weight(u: Array) -> Array:
    return np.minimum(1.0, _K / np.maximum(np.abs(u), _K))
