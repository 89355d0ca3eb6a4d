"""Partial least squares regression under the names of the paper (eq. 14 to 27).

scikit-learn fits; here are the scaling of the paper, its names, and the rule for when
nothing is left to explain.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from sklearn.cross_decomposition import PLSRegression

from residual.errors import InputError
from residual.recording import Array
from residual.tables.blocks import (
    EXHAUSTED,
    as_block,
    as_names,
    as_pair,
    check_count,
    check_varying,
    frozen,
)

# The weights are an eigenvector found by iteration: to the last digits, not to 1e-3.
_TO_THE_END = {"tol": 1e-24, "max_iter": 20_000}


@dataclass(frozen=True, eq=False, slots=True)
class Pls:
    """A fitted model; everything holds for scaled X, `coefficients` for X as given.

    Columns are components; any number of leading ones is a model of its own.

    Attributes:
        names: Variables of X.
        x_mean, x_scale: Mean and standard deviation of X (paper, eq. 18). Shape (k,).
        y_mean, y_scale: The same of Y; the scale is 1 unless asked for. Shape (j,).
        T: Orthogonal scores (eq. 14). Shape (n, A).
        W: Orthonormal loading weights (eq. 19). Shape (k, A).
        V: Weights that give scores from X itself, V = W (P'W)^-1 (eq. 19). (k, A).
        P, Q: Loadings of X and Y (eq. 16). Shapes (k, A), (j, A).
    """

    names: tuple[str, ...]
    x_mean: Array
    x_scale: Array
    y_mean: Array
    y_scale: Array
    T: Array
    W: Array
    V: Array
    P: Array
    Q: Array

    @property
    def components(self) -> int:
        """Number of components A."""
        return self.T.shape[1]

    def coefficients(self, components: int | None = None) -> Array:
        """B = V Q' (eq. 25), in units of Y per unit of X. Shape (k, j).

        Raises:
            InputError: If there are not so many components.
        """
        a = self._count(components)
        return (self.V[:, :a] / self.x_scale[:, None]) @ (
            self.Q[:, :a].T * self.y_scale
        )

    def offset(self, components: int | None = None) -> Array:
        """b0 = ybar - xbar B (eq. 26), in units of Y. Shape (j,)."""
        return self.y_mean - self.x_mean @ self.coefficients(components)

    def transform(self, X: Array, components: int | None = None) -> Array:
        """Scores of new rows, t = (x - xbar) V (eq. 21). Shape (m, a)."""
        X = as_block(X, "X")
        if X.shape[1] != len(self.names):
            raise InputError(
                f"X has {X.shape[1]} columns, the model was fitted to "
                f"{len(self.names)}: {', '.join(self.names)}. Give these, in order."
            )
        return (X - self.x_mean) / self.x_scale @ self.V[:, : self._count(components)]

    def predict(self, X: Array, components: int | None = None) -> Array:
        """Return b0 + x B (eq. 24), in units of Y. Shape (m, j)."""
        X = as_block(X, "X")
        return self.offset(components) + X @ self.coefficients(components)

    def _count(self, components: int | None) -> int:
        if components is None:
            return self.components
        remedy = "Ask for fewer, or fit again with more."
        return check_count(components, 0, self.components, "components", remedy)


def fit_pls(
    X: Array,
    Y: Array,
    components: int | None = None,
    *,
    names: Sequence[str] | None = None,
    scale_y: bool = False,
) -> Pls:
    """Fit a partial least squares regression (paper, eq. 14 to 27).

    Columns of X are scaled to unit variance: rad, rad/s and rad/s^2 do not compare.
    Fewer components than asked for come back where nothing of Y is left to explain.

    Args:
        X: Regressors. Shape (n, k).
        Y: Responses. Shape (n, j).
        components: Number A; as many as the rank of X if None.
        scale_y: Also scale Y, so that no response dominates by its size.

    Raises:
        InputError: On a constant column, more components than the rank of X, blocks
            of different length, or a value that is not finite.
    """
    X, Y = as_pair(X, Y)
    names = as_names(names, X.shape[1], "x")
    check_count(len(X), 2, 2**62, "rows of X", "Take a longer log.")
    check_varying(X, names)
    x_mean, y_mean = X.mean(axis=0), Y.mean(axis=0)
    x_scale = X.std(axis=0, ddof=1)
    # A constant response stays as it is: nothing of it is left after centring.
    y_scale = Y.std(axis=0, ddof=1) if scale_y else np.ones(Y.shape[1])
    y_scale = np.where(y_scale > 0, y_scale, 1.0)
    Z = (X - x_mean) / x_scale
    rank = int(np.linalg.matrix_rank(Z))
    remedy = f"The bound is the rank of X ({len(X)} rows, {X.shape[1]} columns)."
    count = check_count(
        rank if components is None else components, 1, rank, "components", remedy
    )
    parts = _components(Z, (Y - y_mean) / y_scale, count)
    return Pls(names, *map(frozen, (x_mean, x_scale, y_mean, y_scale, *parts)))


def _components(Z: Array, F: Array, count: int) -> tuple[Array, ...]:
    """T, W, V, P and Q of scaled blocks, without components that are rounding."""
    with warnings.catch_warnings():
        # Of a response that is explained, or of weights that rounding keeps moving.
        warnings.simplefilter("ignore")
        fit = PLSRegression(count, scale=False, **_TO_THE_END).fit(Z, F)
    T, Q = fit.x_scores_, fit.y_loadings_
    # |w'E'F| of each component, by Q = F't / t't
    covariance = (T**2).sum(axis=0) * np.linalg.norm(Q, axis=0)
    rounding = covariance <= EXHAUSTED * covariance[0]
    used = int(np.argmax(rounding)) if rounding.any() else count
    parts = T, fit.x_weights_, fit.x_rotations_, fit.x_loadings_, Q
    return tuple(np.ascontiguousarray(part[:, :used]) for part in parts)
