"""Evidence that a motion will bring, and that a log did bring, from Gram matrices.

Each rival says of new rows y, whitened: y ~ N(X mu, I + X S X'), with mu and S its
posterior after the logs so far and X its columns on the new motion. All follows from
G = X' X of the columns that the rivals share, by the matrix inversion lemma.

The expected log Bayes factor for A, A being true, is the Kullback-Leibler divergence
of the two predictive densities (Box & Hill 1967, eq. 3.6 without the sum over models).
Its quadratic part is the T-criterion of Atkinson & Fedorov 1975, with B refitted under
its posterior; the rest averages over what is not known of A itself.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from residual.planning.question import Rival
from residual.recording import Array


@dataclass(frozen=True, eq=False, slots=True)
class Refit:
    """A rival after new rows, scaled so that its posterior precision has ones.

    Attributes:
        rival: The rival.
        scale: Standard deviations by which coefficients are scaled. Shape (k,).
        factor: Lower Cholesky factor of precision + G, scaled. Shape (k, k).
        log_det: ln det(precision + G) - ln det(precision).
    """

    rival: Rival
    scale: Array
    factor: Array
    log_det: float

    @classmethod
    def of(cls, rival: Rival, gram: Array) -> "Refit":
        """Factor once what all questions about a motion share.

        Args:
            gram: Gram of the shared columns on the motion, whitened. Shape (m, m).
        """
        scale = 1 / np.sqrt(np.diag(rival.precision))
        both = np.outer(scale, scale)
        before = np.linalg.slogdet(rival.precision * both)[1]
        own = gram[np.ix_(rival.columns, rival.columns)]
        after = (rival.precision + own) * both
        factor = cho_factor(after, lower=True)[0]
        log_det = 2 * np.log(np.diag(factor)).sum() - before
        return cls(rival, scale, np.tril(factor), float(log_det))

    def solve(self, right: Array) -> Array:
        """(precision + G)^-1 times some columns. Shape (k, ...) as given."""
        scale = self.scale if right.ndim == 1 else self.scale[:, None]
        return scale * cho_solve((self.factor, True), scale * right)


def gap(gram: Array, a: Rival, b: Refit) -> float:
    """What B, refitted, leaves of the difference of the two means, squared [2 nats].

    Args:
        gram: Gram of the shared columns, whitened. Shape (m, m).
    """
    apart = np.zeros(len(gram))
    apart[a.columns] += a.mean
    apart[b.rival.columns] -= b.rival.mean
    seen = gram @ apart
    pull = seen[b.rival.columns]
    return max(float(apart @ seen - pull @ b.solve(pull)), 0.0)


def expected_nats(gram: Array, a: Refit, b: Refit) -> float:
    """Expected log Bayes factor of A against B on a motion, A being true [nats].

    0.5 (d' S_B^-1 d + tr(S_B^-1 S_A) - n + ln det S_B - ln det S_A)

    Args:
        gram: Gram of the shared columns, whitened. Shape (m, m).
    """
    first, other = a.rival.columns, b.rival.columns
    mixed = gram[np.ix_(other, first)]
    left = gram[np.ix_(first, first)] - mixed.T @ b.solve(mixed)
    own = gram[np.ix_(other, other)]
    # tr(S_A-part): posterior covariance of A, by its scaled precision.
    scaled = a.rival.precision * np.outer(a.scale, a.scale)
    spread = np.linalg.solve(scaled, left * np.outer(a.scale, a.scale))
    traces = np.trace(spread) - np.trace(b.solve(own))
    value = gap(gram, a.rival, b) + traces + b.log_det - a.log_det
    return max(0.5 * float(value), 0.0)


def log_evidence(products: Array, gram: Array, b: Refit) -> Array:
    """Log evidence of new rows for a rival, up to what all rivals share [nats].

    Args:
        products: X' y of the shared columns, whitened; one column per draw of y.
            Shape (m, draws).
        gram: X' X. Shape (m, m).

    Returns:
        Shape (draws,).
    """
    at, mean = b.rival.columns, b.rival.mean
    own = gram[np.ix_(at, at)]
    left = products[at] - (own @ mean)[:, None]
    fit = 2 * mean @ products[at] - mean @ own @ mean
    return 0.5 * (fit + np.einsum("kd,kd->d", left, b.solve(left)) - b.log_det)


def drawn_products(
    gram: Array, a: Refit, rng: np.random.Generator, draws: int
) -> Array:
    """X' y of logs that A would give on a motion. Shape (m, draws).

    Args:
        gram: X' X, whitened. Shape (m, m).
    """
    rival = a.rival
    scaled = rival.precision * np.outer(a.scale, a.scale)
    lower = np.linalg.cholesky(scaled)
    free = rng.normal(size=(len(rival.mean), draws))
    theta = a.scale[:, None] * solve_triangular(lower.T, free)
    theta += rival.mean[:, None]
    return gram[:, rival.columns] @ theta + _root(gram) @ rng.normal(
        size=(len(gram), draws)
    )


def _root(gram: Array) -> Array:
    """R with R R' = G, for a G that may be singular. Shape (m, m)."""
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    values, vectors = np.linalg.eigh(gram / np.outer(size, size))
    return size[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
