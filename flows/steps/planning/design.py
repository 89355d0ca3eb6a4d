"""The motion that answers a question best, and what the usual ones would do."""

from dataclasses import dataclass, replace

import numpy as np

from flows.progress import Progress
from flows.steps.planning.improve import improve
from flows.steps.planning.motions import (
    FOURIER,
    Motion,
    Search,
    drawn,
    fourier,
    planned,
    seconds_to,
)
from residual.planning.outlook import chance
from residual.planning.promise import told_apart
from residual.planning.question import Place
from sim.records import TrajectorySpec
from sim.streams import stream
from sim.trajectories.reference import KINDS

MANY = 60  # random motions
_STARTS, _LOOKS = 2, 350  # of local searches, and motions that each may look at
_SEEDS = 3  # of every other family
_PERIODS = 2  # of motions that nobody designed: what a specification has by default

RANDOM, D_OPTIMAL = "random fourier", "D-optimal fourier"


@dataclass(frozen=True, slots=True)
class Compared:
    """What a usual motion of the same length and limits would do.

    Attributes:
        name: What it is.
        nats: Expected evidence of the pair that it tells least [nats].
        seconds: After how long every pair is expected to have enough [s]; None
            where all of it is not enough.
    """

    name: str
    nats: float
    seconds: float | None


@dataclass(frozen=True, eq=False, slots=True)
class Design:
    """A motion for a question.

    Attributes:
        search: What it answers.
        best: The motion.
        chance: Chance that it settles the question.
        seconds: After how long of it every pair is expected to have enough [s]; None
            where all of it is not enough, or nobody looked.
        compared: What others would do.
    """

    search: Search
    best: Motion
    chance: float
    seconds: float | None = None
    compared: tuple[Compared, ...] = ()

    @property
    def rivals(self) -> tuple[Place, ...]:
        """What the motion tells apart, each once."""
        return told_apart(self.search.question, self.best.seen)


def design(search: Search, tell: Progress | None = None) -> Design:
    """Return the best motion of all families that a seeded search finds.

    Random Fourier motions are ranked; a local search improves the best of them, the
    D-optimal one among the starts; motions of the other families are drawn.

    Args:
        search: What is looked for.
        tell: Told the stage and the share done.
    """
    tell = tell or (lambda stage, share: None)
    motions = drawn(search, MANY)
    looked = [fourier(search, *m) for m in motions]
    order = np.argsort([-m.seen.worth for m in looked])
    tell("other motions", 0.1)
    others = _families(search)
    starts, found = [motions[i] for i in order[:_STARTS]], [looked[order[0]]]
    for i, (place, series) in enumerate(starts):
        tell("better motions", 0.3 + 0.7 * i / len(starts))
        better = improve(search, place, series, _LOOKS)
        found.append(fourier(search, place, better))
    usual = looked[order[len(order) // 2]]
    every = [*found, *(m for m in others.values() if m)]
    best = max(every, key=lambda motion: motion.seen.worth)
    named = {RANDOM: usual, **others}
    compared = [_compared(search, name, m) for name, m in named.items() if m]
    tell("better motions", 1.0)
    seconds = seconds_to(search, best)
    return replace(_design(search, best), seconds=seconds, compared=tuple(compared))


def _families(search: Search) -> dict[str, Motion | None]:
    """Return the D-optimal motion, and the best of some of every other family."""
    periods = min(_PERIODS, max(search.periods))

    def of(kind: str, seed: int) -> Motion | None:
        seed = 100 * search.seed + seed
        return planned(search, TrajectorySpec(kind, search.seconds, periods, seed))

    out = {D_OPTIMAL: of(FOURIER, 0)}
    for kind in (k for k in KINDS if k != FOURIER):
        found = [m for seed in range(_SEEDS) if (m := of(kind, seed))]
        out[kind] = max(found, key=lambda m: m.seen.worth, default=None)
    return out


def _design(search: Search, best: Motion) -> Design:
    rng = stream(search.seed, "next/chance")
    return Design(search, best, chance(search.question, best.gram, search.twins, rng))


def _compared(search: Search, name: str, motion: Motion) -> Compared:
    return Compared(name, motion.seen.least, seconds_to(search, motion))
