"""What a motion promises for a question: nats for every pair, chance, seconds.

Each rival says of new rows y, whitened: y ~ N(X mu, I + X S X'), with mu and S its
posterior after the logs so far and X its columns on the new motion. All follows from
G = X' X of the columns that the rivals share, by the matrix inversion lemma.

What is expected of A against B is the log Bayes factor that a log brings whose truth is
A at the size that was found, mu. Its quadratic part is the T-criterion of Atkinson &
Fedorov 1975, with B refitted under its posterior. The average over what is not known of
A (the Kullback-Leibler divergence, Box & Hill 1967, eq. 3.6) is no number to go by: the
few largest sizes that the logs so far allow carry it. What is not known of A is in the
chance, which is counted in drawn logs.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from residual.planning.question import Question, Rival
from residual.recording import Array

DRAWS = 400  # logs that a chance is counted in
HOPELESS = 1 / 6  # of what is needed: what brings less decides nothing
Pair = tuple[int, int, int]  # contest, true rival, other rival


@dataclass(frozen=True, eq=False, slots=True)
class Refit:
    """A rival after new rows, scaled so that its posterior precision has ones."""

    rival: Rival
    scale: Array  # standard deviations by which coefficients are scaled, (k,)
    factor: Array  # lower Cholesky factor of precision + G, scaled, (k, k)
    log_det: float  # ln det(precision + G) - ln det(precision)
    learned: float  # numbers that the new rows determine, tr((precision + G)^-1 G)

    @classmethod
    def of(cls, rival: Rival, gram: Array) -> "Refit":
        """Factor once what all questions about a motion share: its Gram. (m, m)."""
        scale = 1 / np.sqrt(np.diag(rival.precision))
        both = np.outer(scale, scale)
        known = rival.precision * both
        own = gram[np.ix_(rival.columns, rival.columns)]
        factor = cho_factor(known + own * both, lower=True)[0]
        log_det = 2 * np.log(np.diag(factor)).sum() - np.linalg.slogdet(known)[1]
        learned = len(scale) - np.trace(cho_solve((factor, True), known))
        return cls(rival, scale, np.tril(factor), float(log_det), float(learned))

    def solve(self, right: Array) -> Array:
        """(precision + G)^-1 times some columns. Shape (k, ...) as given."""
        scale = self.scale if right.ndim == 1 else self.scale[:, None]
        return scale * cho_solve((self.factor, True), scale * right)


def expected_nats(gram: Array, a: Refit, b: Refit) -> float:
    """Expected log Bayes factor of A against B, A at its found size being true [nats].

    0.5 (d' S_B^-1 d + tr S_B^-1 - tr S_A^-1 + ln det S_B - ln det S_A); below 0 where B
    says more surely what A says, too. The first part is what B, refitted, leaves of the
    difference d of the two means. The Gram is whitened, (m, m).
    """
    apart = np.zeros(len(gram))
    apart[a.rival.columns] += a.rival.mean
    apart[b.rival.columns] -= b.rival.mean
    seen = gram @ apart
    pull = seen[b.rival.columns]
    gap = max(float(apart @ seen - pull @ b.solve(pull)), 0.0)
    certainty = a.learned - b.learned + b.log_det - a.log_det
    return 0.5 * (gap + certainty)


def log_evidence(products: Array, gram: Array, b: Refit) -> Array:
    """Log evidence of new rows for a rival, up to what all rivals share [nats].

    Of X' y of the shared columns, whitened, one column per draw of y, (m, draws), and
    X' X, (m, m). Shape (draws,).
    """
    at, mean = b.rival.columns, b.rival.mean
    own = gram[np.ix_(at, at)]
    left = products[at] - (own @ mean)[:, None]
    fit = 2 * mean @ products[at] - mean @ own @ mean
    return 0.5 * (fit + np.einsum("kd,kd->d", left, b.solve(left)) - b.log_det)


def drawn_products(
    gram: Array, a: Refit, rng: np.random.Generator, draws: int
) -> Array:
    """X' y of logs that A would give on a motion. Shape (m, draws)."""
    rival = a.rival
    scaled = rival.precision * np.outer(a.scale, a.scale)
    lower = np.linalg.cholesky(scaled)
    free = rng.normal(size=(len(rival.mean), draws))
    theta = a.scale[:, None] * solve_triangular(lower.T, free)
    theta += rival.mean[:, None]
    # R with R R' = G, for a G that may be singular.
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    values, vectors = np.linalg.eigh(gram / np.outer(size, size))
    root = size[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    noise = rng.normal(size=(len(gram), draws))
    return gram[:, rival.columns] @ theta + root @ noise


@dataclass(frozen=True, eq=False, slots=True)
class Outlook:
    """What a motion promises, at the sizes that the logs so far found."""

    # Expected evidence of each pair that a motion can tell apart [nats].
    nats: Mapping[Pair, float]
    # Of the evidence that the pairs still need, how much the worst of them gets: at 1
    # all are expected to be apart.
    share: float

    @property
    def hopeless(self) -> bool:
        """Whether it decides nothing."""
        return self.share < HOPELESS


def outlook(
    question: Question, gram: Array, twins: frozenset[Pair] = frozenset()
) -> Outlook:
    """Weigh one motion by its Gram, (m, m), but for pairs that it cannot tell apart."""
    nats, shares = {}, []
    for c, contest in enumerate(question.contests):
        after = [Refit.of(rival, gram) for rival in contest.rivals]
        for a, b in contest.pairs:
            if (c, a, b) in twins:
                continue
            value = max(expected_nats(gram, after[a], after[b]), 0.0)
            nats[c, a, b] = value
            need = contest.enough - contest.lead(a, b)
            shares.append(value / need if need > 0 else np.inf)
    return Outlook(nats, float(min(shares, default=0.0)))


class Prospect(NamedTuple):
    """What logs of a motion would bring, counted in logs as the rivals would give them.

    The chance that the true rival leads every other from which a motion can tell it by
    enough, old logs included; and its median lead over the nearest [nats].
    """

    chance: float
    nats: float


def prospect(
    question: Question, gram: Array, twins: frozenset[Pair], rng: np.random.Generator
) -> Prospect:
    """Draw logs of every rival, as probable as the logs so far make it.

    A rival that no motion can tell from any other is left out. The Gram is whitened,
    (m, m).
    """
    chances, nats = [], []
    for c, contest in enumerate(question.contests):
        after = [Refit.of(rival, gram) for rival in contest.rivals]
        before = np.array([rival.nats for rival in contest.rivals])
        leads, odds = [], []  # of the true rival over the nearest [nats]
        for a, share in enumerate(np.exp(before - before.max())):
            pairs = (b for x, b in contest.pairs if x == a)
            others = [b for b in pairs if (c, a, b) not in twins]
            if not others:
                continue
            products = drawn_products(gram, after[a], rng, DRAWS)
            own = before[a] + log_evidence(products, gram, after[a])
            best = [before[b] + log_evidence(products, gram, after[b]) for b in others]
            leads.append(own - np.max(best, axis=0))
            odds.append(np.full(DRAWS, share))
        if leads:
            lead, weight = np.concatenate(leads), np.concatenate(odds)
            weight = weight / max(weight.sum(), 1e-300)
            chances.append(float(weight @ (lead >= contest.enough)))
            order = np.argsort(lead)
            half = np.searchsorted(np.cumsum(weight[order]), 0.5)
            nats.append(float(lead[order][min(half, len(lead) - 1)]))
    if not chances:
        return Prospect(0.0, 0.0)
    return Prospect(min(float(np.prod(chances)), 1.0), min(nats))
