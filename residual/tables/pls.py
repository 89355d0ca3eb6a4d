"""Partial least squares regression with every quantity that the paper names.

Eq. 14 to 27 of the paper, by the kernel algorithm 1 of Dayal, B. S. and MacGregor,
J. F. (1997), J. Chemometrics 11, 73-85: X is never deflated, only X'Y is.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from residual.errors import InputError
from residual.recording import Array
from residual.tables.blocks import (
    as_block,
    as_names,
    as_pair,
    check_count,
    check_varying,
    frozen,
)

# Covariance below this share of the first one is rounding: nothing is left to explain.
EXHAUSTED = 1e-12


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
        V: Weights that give scores from X itself, V = W G (eq. 19). Shape (k, A).
        P, Q: Loadings of X and Y (eq. 16). Shapes (k, A), (j, A).
        G: (P'W)^-1, upper triangular (eq. 20 says bidiagonal). Shape (A, A).
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
    G: Array

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
        return self._scaled(X) @ self.V[:, : self._count(components)]

    def predict(self, X: Array, components: int | None = None) -> Array:
        """Return b0 + x B (eq. 24), in units of Y. Shape (m, j)."""
        X = as_block(X, "X")
        return self.offset(components) + X @ self.coefficients(components)

    def x_unexplained(self, X: Array, components: int | None = None) -> Array:
        """e_i = x_i - xhat_i in scaled units (eq. 22, 23). Shape (m, k)."""
        a = self._count(components)
        return self._scaled(X) - self.transform(X, a) @ self.P[:, :a].T

    def y_unexplained(self, X: Array, Y: Array, components: int | None = None) -> Array:
        """f_i = y_i - yhat_i in units of Y (eq. 27). Shape (m, j)."""
        X, Y = as_pair(X, Y)
        return Y - self.predict(X, components)

    def _count(self, components: int | None) -> int:
        if components is None:
            return self.components
        remedy = "Ask for fewer, or fit again with more."
        return check_count(components, 0, self.components, "components", remedy)

    def _scaled(self, X: Array) -> Array:
        X = as_block(X, "X")
        if X.shape[1] != len(self.names):
            raise InputError(
                f"X has {X.shape[1]} columns, the model was fitted to "
                f"{len(self.names)}: {', '.join(self.names)}. Give these, in order."
            )
        return (X - self.x_mean) / self.x_scale


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
    Fewer components than asked for come back where all that X can tell about Y is told.

    Args:
        X: Regressors. Shape (n, k).
        Y: Responses. Shape (n, j).
        components: Number A; as many as the rank of X if None.
        names: Names of X's columns.
        scale_y: Also scale Y, so that no response dominates by its size.

    Raises:
        InputError: On a constant column, more components than the rank of X, blocks
            of different length, or a value that is not finite.
    """
    X, Y = as_pair(X, Y)
    names = as_names(names, X.shape[1], "x")
    check_count(len(X), 2, 2**62, "rows of X", "Take a longer log.")
    check_varying(X, names)
    means = X.mean(axis=0), Y.mean(axis=0)
    x_scale = X.std(axis=0, ddof=1)
    # A constant response stays as it is: nothing of it is left after centring.
    y_scale = Y.std(axis=0, ddof=1) if scale_y else np.ones(Y.shape[1])
    y_scale = np.where(y_scale > 0, y_scale, 1.0)
    Z = (X - means[0]) / x_scale
    rank = int(np.linalg.matrix_rank(Z))
    count = rank if components is None else components
    check_count(
        count,
        1,
        rank,
        "components",
        f"The bound is the rank of X ({len(X)} rows, {X.shape[1]} columns).",
    )
    parts = _kernel_pls(Z, (Y - means[1]) / y_scale, count)
    scales = (means[0], x_scale, means[1], y_scale)
    G = np.linalg.inv(parts[3].T @ parts[1])
    return Pls(names, *map(frozen, (*scales, *parts, G)))


def _kernel_pls(Z: Array, F: Array, count: int) -> tuple[Array, ...]:
    """Dayal and MacGregor's algorithm 1; returns T, W, V, P, Q."""
    S = Z.T @ F
    found: list[tuple[Array, ...]] = []
    first = 0.0
    for _ in range(count):
        # w: eigenvector of E'FF'E to its largest eigenvalue (below eq. 18).
        left, singular, _ = np.linalg.svd(S, full_matrices=False)
        first = first or singular[0]
        if singular[0] <= EXHAUSTED * first:
            break
        w = left[:, 0] * np.sign(left[np.abs(left[:, 0]).argmax(), 0])
        # v: the same weights for X itself, before anything was taken from it.
        v = w - sum((p @ w) * earlier for _, _, earlier, p, _ in found)
        t = Z @ v
        energy = t @ t
        p, q = Z.T @ t / energy, S.T @ v / energy
        S = S - energy * np.outer(p, q)
        found.append((t, w, v, p, q))
    if not found:
        widths = (len(Z), Z.shape[1], Z.shape[1], Z.shape[1], F.shape[1])
        return tuple(np.zeros((width, 0)) for width in widths)
    return tuple(np.column_stack(columns) for columns in zip(*found, strict=True))
