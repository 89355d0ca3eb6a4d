"""Principal components and partial least squares under the names of the paper.

Sections 2.3 and 2.4, eq. 12 to 27, and how many components are more than chance.

Chance, by parallel analysis: Horn, J. L. (1965), Psychometrika 30, compares with white
noise. Rows of a log are autocorrelated: two slow signals of no relation correlate by
chance. So chance is drawn with the spectrum of every variable kept (phase
randomisation: Theiler et al. 1992, Physica D 58).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from residual.errors import InputError
from residual.quantity import (
    as_block,
    as_names,
    as_pair,
    as_rows,
    check_count,
    check_varying,
    frozen,
)
from residual.recording import Array
from residual.signals.filters import randomise_phases

# Covariance below this share of the first one is rounding: nothing is left to explain.
EXHAUSTED = 1e-12
LEAST_DRAWS = 20  # a 95 % limit from fewer is their maximum
_QUANTILE = 0.95  # of the surrogates, that chance may not exceed


@dataclass(frozen=True, eq=False, slots=True)
class Pls:
    """A fitted regression; any number of leading components is a model of its own."""

    names: tuple[str, ...]  # variables of X
    # Mean and standard deviation of X (paper, eq. 18), (k,).
    x_mean: Array
    x_scale: Array
    y_mean: Array  # mean of Y, (j,)
    V: Array  # weights that give scores from scaled X itself (eq. 19), (k, A)
    Q: Array  # loadings of Y (eq. 16), (j, A)

    def transform(self, X: Array) -> Array:
        """Scores of new rows, t = (x - xbar) V (eq. 21). Shape (m, A)."""
        X = as_rows(X, self.names, "the model was fitted to")
        return (X - self.x_mean) / self.x_scale @ self.V

    def linear(self, components: int) -> tuple[Array, Array]:
        """Constant (j,) and slope (k, j) of some leading components (eq. 25, 26)."""
        a = components
        slope = self.V[:, :a] @ self.Q[:, :a].T / self.x_scale[:, None]
        return self.y_mean - self.x_mean @ slope, slope


def fit_pls(
    X: Array,
    Y: Array,
    components: int | None = None,
    *,
    names: Sequence[str] | None = None,
) -> Pls:
    """Fit a partial least squares regression (paper, eq. 14 to 27).

    Kernel PLS (Dayal and MacGregor 1997, algorithm 1), from Z'Z and Z'Y alone. Columns
    of X are scaled to unit variance: rad, rad/s and rad/s^2 do not compare. Fewer
    components than asked for come back where nothing of Y is left to explain.

    Args:
        X: Regressors. Shape (n, k).
        Y: Responses. Shape (n, j).
        components: Number A; as many as the rank of X if None.

    Raises:
        InputError: On a constant column, more components than the rank of X, blocks
            of different length, or a value that is not finite.
    """
    X, Y = as_pair(X, Y)
    names = as_names(names, X.shape[1], "x")
    check_count(len(X), 2, 2**62, "rows of X", "Take a longer log.")
    check_varying(X, names)
    x_mean, x_scale, y_mean = X.mean(axis=0), X.std(axis=0, ddof=1), Y.mean(axis=0)
    Z = (X - x_mean) / x_scale
    rank = int(np.linalg.matrix_rank(Z))
    remedy = f"The bound is the rank of X ({len(X)} rows, {X.shape[1]} columns)."
    requested = rank if components is None else components
    count = check_count(requested, 1, rank, "components", remedy)
    parts = _components(Z.T @ Z, Z.T @ (Y - y_mean), count)
    return Pls(names, *map(frozen, (x_mean, x_scale, y_mean, *parts)))


def leading(S: Array) -> tuple[Array, float]:
    """Eigenvector of S S' to its largest eigenvalue, and S's norm. Shape (j, p)."""
    values, vectors = np.linalg.eigh(S @ S.T)
    q = np.ascontiguousarray(vectors[:, -1])
    return q * np.sign(q[np.abs(q).argmax()]), float(max(values[-1], 0.0) ** 0.5)


def _components(G: Array, S: Array, count: int) -> tuple[Array, Array]:
    """Return V and Q from G = Z'Z (k, k) and S = Z'Y (k, j)."""
    V, P, Q = (np.zeros((count, n)) for n in (len(G), len(G), S.shape[1]))
    first, done = 0.0, 0
    for a in range(count):
        q, size = leading(S.T)
        first = first or size
        if size <= EXHAUSTED * first:
            break
        w = S @ q / size
        # Twice: rounding of long products would make late scores oblique.
        v = w - V[:a].T @ (P[:a] @ w)
        V[a] = v - V[:a].T @ (P[:a] @ v)
        energy = V[a] @ G @ V[a]
        P[a], Q[a] = G @ V[a] / energy, V[a] @ S / energy
        S = S - energy * np.outer(P[a], Q[a])
        done = a + 1
    return V[:done].T.copy(), Q[:done].T.copy()


def state_block(q: Array, qd: Array, qdd: Array) -> Array:
    """Return [q, qd, qdd] side by side (paper, eq. 13 and 28). Shape (n, 3 joints)."""
    return np.hstack([as_block(part, "a part of the state") for part in (q, qd, qdd)])


def state_names(joints: Sequence[int]) -> tuple[str, ...]:
    """Names of the columns of `state_block` for joints counted from 1."""
    return tuple(f"{kind}{j}" for kind in ("q", "qd", "qdd") for j in joints)


@dataclass(frozen=True, eq=False, slots=True)
class Pca:
    """Principal components of centred, scaled columns (paper, eq. 12)."""

    names: tuple[str, ...]
    loadings: Array  # orthonormal loadings P, (k, k)
    eigenvalues: Array  # variance of each component; they add up to k, (k,)
    limit: Array  # what 95 of 100 surrogates of the signals do not exceed, (k,)

    @property
    def real(self) -> int:
        """Number of leading components with more variance than chance gives.

        In a correlation matrix a first component too large makes the others small, so
        only an unbroken start is a count.
        """
        return int(np.logical_and.accumulate(self.eigenvalues > self.limit).sum())

    def strongest(self, component: int) -> tuple[tuple[str, float], ...]:
        """The three variables with the largest loadings of a component, with sign."""
        column = self.loadings[:, component]
        order = np.argsort(-np.abs(column), kind="stable")[:3]
        return tuple((self.names[i], float(column[i])) for i in order)


def fit_pca(
    X: Array,
    rng: np.random.Generator,
    names: Sequence[str] | None = None,
    *,
    run: Array | None = None,
    draws: int = 100,
) -> Pca:
    """Return all principal components of signals as columns, in any units.

    The columns are centred and scaled to unit variance first (paper, below eq. 12):
    angles, speeds and accelerations have different units. A sign is chosen so that
    the largest loading of each component is positive. Surrogates are drawn within runs.
    """
    X = as_block(X, "X")
    check_count(len(X), 2, 2**62, "rows of X", "Take a longer log.")
    names = as_names(names, X.shape[1], "x")
    check_varying(X, names)
    check_count(draws, LEAST_DRAWS, 10**6, "draws", "100 are usual.")
    run = np.zeros(len(X), int) if run is None else np.asarray(run)
    if run.shape != (len(X),):
        raise InputError(f"run has shape {run.shape}, expected ({len(X)},).")
    parts = [np.flatnonzero(run == label) for label in np.unique(run)]
    shortest = min(map(len, parts))
    check_count(shortest, 4, len(X), "rows of a run", "Leave short runs out.")
    values, vectors = np.linalg.eigh(_correlation(X))
    largest = np.abs(vectors).argmax(axis=0)
    vectors = vectors * np.sign(vectors[largest, range(len(names))])
    spectra = [np.fft.rfft(X[rows] - X[rows].mean(0), axis=0) for rows in parts]
    means = np.concatenate([np.repeat(X[r].mean(0)[None], len(r), 0) for r in parts])
    drawn = np.empty((draws, X.shape[1]))
    for i in range(draws):
        pairs = zip(spectra, parts, strict=True)
        new = [randomise_phases(s, len(rows), rng) for s, rows in pairs]
        drawn[i] = np.linalg.eigvalsh(_correlation(np.concatenate(new) + means))[::-1]
    limit = np.quantile(drawn, _QUANTILE, axis=0)
    ordered = vectors[:, ::-1].copy(), values[::-1].copy(), limit
    return Pca(names, *map(frozen, ordered))


def _correlation(X: Array) -> Array:
    return np.corrcoef(X.T).reshape(X.shape[1], -1)
