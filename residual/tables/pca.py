"""Principal components of a block of signals (paper, section 2.3, eq. 12 and 13)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from sklearn.decomposition import PCA

from residual.recording import Array
from residual.tables.blocks import (
    as_block,
    as_names,
    check_count,
    check_varying,
    frozen,
)


@dataclass(frozen=True, eq=False, slots=True)
class Pca:
    """Principal components of centred, scaled columns.

    X = xbar + (T P' + E) s    (paper, eq. 12; s the standard deviations)

    Attributes:
        names: The variables, as columns of X.
        mean, scale: Mean and standard deviation of each column, in the units of X.
            Shapes (k,).
        loadings: Orthonormal loadings P. Shape (k, a).
        scores: Scores T, dimensionless. Shape (n, a).
        eigenvalues: Variance of each component; they add up to k. Shape (a,).
    """

    names: tuple[str, ...]
    mean: Array
    scale: Array
    loadings: Array
    scores: Array
    eigenvalues: Array

    @property
    def explained(self) -> Array:
        """Share of the whole variance per component, adding up to 1. Shape (a,)."""
        return self.eigenvalues / len(self.names)

    def strongest(
        self, component: int, count: int = 3
    ) -> tuple[tuple[str, float], ...]:
        """Variables with the largest loadings of a component (from 0), with sign."""
        column = self.loadings[:, component]
        order = np.argsort(-np.abs(column), kind="stable")[:count]
        return tuple((self.names[i], float(column[i])) for i in order)


def fit_pca(X: Array, names: Sequence[str] | None = None) -> Pca:
    """Return the principal components of a block, all of them.

    The columns are centred and scaled to unit variance first (paper, below eq. 12):
    angles, speeds and accelerations have different units. A sign is chosen so that
    the largest loading of each component is positive.

    Args:
        X: Signals as columns, any units. Shape (n, k).
        names: One name per column; made up if None.

    Raises:
        InputError: On a value that is not finite, a constant column, or one row.
    """
    X = as_block(X, "X")
    check_count(len(X), 2, 2**62, "rows of X", "Take a longer log.")
    names = as_names(names, X.shape[1], "x")
    check_varying(X, names)
    mean, scale = X.mean(axis=0), X.std(axis=0, ddof=1)
    Z = (X - mean) / scale
    fit = PCA(svd_solver="full").fit(Z)
    # The sign is scikit-learn's: of a component's loadings the largest is positive.
    P = np.ascontiguousarray(fit.components_.T)
    parts = mean, scale, P, Z @ P, fit.explained_variance_
    return Pca(names, *map(frozen, parts))


def state_block(q: Array, qd: Array, qdd: Array) -> Array:
    """Return [q, qd, qdd] side by side (paper, eq. 13 and 28). Shape (n, 3 joints)."""
    return np.hstack([as_block(part, "a part of the state") for part in (q, qd, qdd)])


def state_names(joints: Sequence[int]) -> tuple[str, ...]:
    """Names of the columns of `state_block` for joints counted from 1."""
    return tuple(f"{kind}{j}" for kind in ("q", "qd", "qdd") for j in joints)
