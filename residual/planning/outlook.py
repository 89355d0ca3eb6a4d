"""What a motion promises for a question: nats for every pair, chance, seconds.

Each rival says of new rows y, whitened: y ~ N(X mu, I + X S X'), with mu and S its
posterior after the logs so far and X its columns on the new motion. All follows from
G = X' X of the columns that the rivals share, by the matrix inversion lemma.

The expected log Bayes factor for A, A being true, is the Kullback-Leibler divergence
of the two predictive densities (Box & Hill 1967, eq. 3.6 without the sum over models).
Its quadratic part is the T-criterion of Atkinson & Fedorov 1975, with B refitted under
its posterior; the rest averages over what is not known of A itself.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from residual.evidence.rules import RULES
from residual.planning.question import Contest, Question, Rival
from residual.recording import Array

DRAWS = 400  # logs that a chance is counted in
HOPELESS = 1.0  # nats: a motion that promises less decides nothing
TWIN = 0.01  # of the power of what one has beyond the other, on any motion
Pair = tuple[int, int, int]  # contest, true rival, other rival


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


@dataclass(frozen=True, eq=False, slots=True)
class Outlook:
    """What a motion promises.

    Attributes:
        nats: Expected evidence of each pair that a motion can tell apart [nats].
        parted: Of pairs of one kind, how far they come apart: 1 is enough for the rule
            by which a diagnosis calls them equivalent.
        least: The least of them; 0 where there is no such pair.
        worth: The least, where pairs of one kind count only as far as the rule of a
            diagnosis would part them; this is what is made as large as possible.
    """

    nats: Mapping[Pair, float]
    parted: Mapping[Pair, float]
    least: float
    worth: float


def outlook(
    question: Question, gram: Array, twins: frozenset[Pair] = frozenset()
) -> Outlook:
    """Weigh one motion.

    Args:
        gram: Whitened Gram of the shared columns on the motion. Shape (m, m).
    """
    nats, parted, worth = {}, {}, [np.inf]
    for c, contest in enumerate(question.contests):
        after = [Refit.of(rival, gram) for rival in contest.rivals]
        for a, b in contest.pairs:
            if (c, a, b) in twins:
                continue
            value = expected_nats(gram, after[a], after[b])
            nats[c, a, b] = value
            if (a, b) in contest.same_family:
                parted[c, a, b] = _parted(contest, gram, a, after[b])
                value = min(value, contest.enough * parted[c, a, b])
            worth.append(value)
    least = min(nats.values(), default=0.0)
    return Outlook(nats, parted, least, float(min(worth)) if nats else 0.0)


def chance(
    question: Question, gram: Array, twins: frozenset[Pair], rng: np.random.Generator
) -> float:
    """Chance that all contests are settled, whichever rival is true.

    Settled means: the true one leads all the others, of which a motion can tell it, by
    enough nats, those of the logs so far included. Rivals are as probable as the logs
    so far make them.

    Args:
        gram: Whitened Gram on the motion. Shape (m, m).
    """
    every = [
        _contest_chance(contest, gram, {t[1:] for t in twins if t[0] == c}, rng)
        for c, contest in enumerate(question.contests)
    ]
    return float(np.prod(every)) if every else 0.0


def _contest_chance(
    contest: Contest, gram: Array, twins: set, rng: np.random.Generator
) -> float:
    after = [Refit.of(rival, gram) for rival in contest.rivals]
    lead = np.array([rival.nats for rival in contest.rivals])
    odds = np.exp(lead - lead.max())
    total = 0.0
    for a, share in enumerate(odds / odds.sum()):
        others = [b for x, b in contest.pairs if x == a and (a, b) not in twins]
        products = drawn_products(gram, after[a], rng, DRAWS)
        own = lead[a] + log_evidence(products, gram, after[a])
        won = np.full(DRAWS, bool(others))
        for b in others:
            other = lead[b] + log_evidence(products, gram, after[b])
            won &= own - other >= contest.enough
            if (a, b) in contest.same_family:
                won &= _parted(contest, gram, a, after[b]) >= 1
        total += share * won.mean()
    return total


def _parted(contest: Contest, gram: Array, a: int, b: Refit) -> float:
    """How far B fails to explain what A does, over what a family has to."""
    true, none = contest.rivals[a], Refit.of(contest.nothing, gram)
    apart = gap(gram, true, b) / 2 + max(true.explained - b.rival.explained, 0.0)
    whole = gap(gram, true, none) / 2 + max(true.explained, 0.0)
    return apart / max(whole, 1e-300) / (1 - RULES.kin)


def realised(
    contest: Contest, gram: Array, products: Array, true: int, other: int
) -> float:
    """Log Bayes factor that a log did bring [nats].

    Args:
        gram: Whitened Gram of the shared columns on the log. Shape (m, m).
        products: X' y. Shape (m,).
        true: Index of the rival that it speaks for where positive.
    """
    values = [
        log_evidence(products[:, None], gram, Refit.of(contest.rivals[i], gram))[0]
        for i in (true, other)
    ]
    return float(values[0] - values[1])


def has_enough(question: Question, gram: Array, twins: frozenset[Pair]) -> bool:
    """Whether every pair is expected to have enough, the logs so far included.

    Args:
        gram: Whitened Gram of a motion. Shape (m, m).
    """
    seen = outlook(question, gram, twins)
    return bool(seen.nats) and all(
        value + _lead(question, pair) >= question.contests[pair[0]].enough
        and seen.parted.get(pair, 1.0) >= 1
        for pair, value in seen.nats.items()
    )


def _lead(question: Question, pair: Pair) -> float:
    rivals = question.contests[pair[0]].rivals
    return rivals[pair[1]].nats - rivals[pair[2]].nats


def structural_twins(question: Question, grams: list[Array]) -> frozenset[Pair]:
    """Return pairs of which the second can be what the first is, on any motion.

    Both ways round they are twins; one way round the first is a case of the second.
    What the nominal model could do in their place is left out: it may be able to
    imitate both, and its values speak for or against that.

    Args:
        grams: Whitened Gram of several free motions. Shapes (m, m).
    """
    total = np.sum(grams, axis=0)
    found = set()
    for c, contest in enumerate(question.contests):
        for a, b in contest.pairs:
            one, other = contest.rivals[a].own, contest.rivals[b].own
            if len(one) and len(other) and _beyond(total, one, other) < TWIN:
                found.add((c, a, b))
    return frozenset(found)


def _beyond(gram: Array, one: Array, other: Array) -> float:
    """Share of the power of one's columns that the other's cannot have."""
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    scaled = gram / np.outer(size, size)
    mixed = scaled[np.ix_(other, one)]
    inner = np.linalg.pinv(scaled[np.ix_(other, other)], rcond=1e-9, hermitian=True)
    left = scaled[np.ix_(one, one)] - mixed.T @ inner @ mixed
    return float(np.linalg.eigvalsh(left).max())
