"""What a motion promises for a question: nats for every pair, chance, seconds."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from residual.diagnosis.gate import KIN
from residual.planning.predictive import (
    Refit,
    drawn_products,
    expected_nats,
    gap,
    log_evidence,
)
from residual.planning.question import Contest, Question
from residual.recording import Array

DRAWS = 400  # logs that a chance is counted in
HOPELESS = 1.0  # nats: a motion that promises less decides nothing
TWIN = 0.01  # of the power of what one has beyond the other, on any motion

Pair = tuple[int, int, int]  # contest, true rival, other rival


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
            if (a, b) in contest.kin:
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
            if (a, b) in contest.kin:
                won &= _parted(contest, gram, a, after[b]) >= 1
        total += share * won.mean()
    return total


def _parted(contest: Contest, gram: Array, a: int, b: Refit) -> float:
    """How far B fails to explain what A does, over what the rule of kin asks for."""
    true, none = contest.rivals[a], Refit.of(contest.nothing, gram)
    apart = gap(gram, true, b) / 2 + max(true.explained - b.rival.explained, 0.0)
    whole = gap(gram, true, none) / 2 + max(true.explained, 0.0)
    return apart / max(whole, 1e-300) / (1 - KIN)


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
