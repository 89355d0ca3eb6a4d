"""The motion that answers a question best, and what the usual ones would do."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize

from flows.outputs import Progress
from flows.steps.planning.motions import (
    COARSER,
    FOURIER,
    Motion,
    Search,
    drawn,
    fourier,
    planned,
    seconds_to,
    series_gram,
)
from residual.diagnosis.result import Place
from residual.planning.outlook import Pair, chance
from residual.planning.promise import told_apart
from residual.planning.question import Question
from sim.engine.records import TrajectorySpec, stream
from sim.trajectories.curves import Series
from sim.trajectories.fourier import (
    FREE,
    fit_in,
    free_of,
    harmonics,
    largest,
    room_left,
    shrunk,
)
from sim.trajectories.limits import Workspace
from sim.trajectories.reference import KINDS

Array = np.ndarray

_REACH = 0.85  # of half of the range, where the centre may lie
_SMALLEST = 0.05  # of the size that the limits allow a joint
_REGION = 0.3  # in which the first steps are taken
_NONE = 1e-3  # nats of a motion that is not possible


@dataclass(frozen=True, eq=False, slots=True)
class Form:
    """A Fourier motion as numbers near one: centres, form and size of every joint.

    Attributes:
        search: What is looked for.
        place: The arm's limits.
    """

    search: Search
    place: Workspace

    @property
    def dof(self) -> int:
        """Number of joints."""
        return self.search.robot.dof

    def numbers(self, series: Series) -> Array:
        """Return the numbers of a motion. Shape (10 dof,)."""
        limits, free = self.place.limits, free_of(series)
        centre = (series.centre - limits.middle) / limits.half
        size = 1 / np.maximum(room_left(self.place, series), 1.0)
        form = free / np.maximum(np.linalg.norm(free, axis=0), 1e-12)
        return np.concatenate([centre, form.ravel(), size])

    def series(self, x: Array) -> Series | None:
        """Return the motion of some numbers, roughly within limits; None for none."""
        limits, dof = self.place.limits, self.dof
        centre = limits.middle + np.clip(x[:dof], -_REACH, _REACH) * limits.half
        free = x[dof:-dof].reshape(FREE, dof)
        whole = largest(self.place, Series(centre, *harmonics(free), self.place.period))
        share = np.clip(x[-dof:], _SMALLEST, 1.0)
        return fit_in(self.place, shrunk(whole, share), roughly=True)

    def cost(self, x: Array) -> float:
        """Return what a better motion makes smaller: minus ln of its worth."""
        series = self.series(x)
        if series is None:
            return -float(np.log(_NONE))
        gram = series_gram(self.search, self.place, series, COARSER)
        return -float(np.log(self.search.weighed(gram).worth + _NONE))


def improve(search: Search, place: Workspace, series: Series, looks: int) -> Series:
    """Return a motion that promises more, by a local search from one."""
    form = Form(search, place)
    start = form.numbers(series)
    found = minimize(
        form.cost,
        start,
        method="COBYLA",  # the least of several pairs has kinks: no derivatives
        options={"maxiter": looks, "rhobeg": _REGION},
    )
    better = form.series(found.x)
    exact = None if better is None else fit_in(place, better)
    return series if exact is None else exact


MANY = 60  # random motions
_STARTS, _LOOKS = 1, 180  # of local searches, and motions that each may look at
_PERIODS = 2  # of motions that nobody designed: what a specification has by default

RANDOM = "random fourier"


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

    Random Fourier motions are ranked by a coarse look; a local search improves the best
    of them; of every other family one motion is drawn.
    """
    tell = tell or (lambda stage, share: None)
    motions = drawn(search, MANY)
    worth = [search.weighed(series_gram(search, *m, COARSER)).worth for m in motions]
    order = np.argsort(worth)[::-1]
    tell("other motions", 0.1)
    others = _families(search)
    starts, found = [motions[i] for i in order[:_STARTS]], []
    for i, (place, series) in enumerate(starts):
        tell("better motions", 0.4 + 0.6 * i / len(starts))
        better = improve(search, place, series, _LOOKS)
        found += [fourier(search, place, one) for one in (series, better)]
    usual = fourier(search, *motions[order[len(order) // 2]])
    named = {RANDOM: usual, **others}
    every = [*found, *others.values()]
    best = max(every, key=lambda motion: motion.seen.worth)
    compared = [_compared(search, name, m) for name, m in named.items()]
    tell("better motions", 1.0)
    seconds = seconds_to(search, best)
    return replace(_design(search, best), seconds=seconds, compared=tuple(compared))


def _families(search: Search) -> dict[str, Motion]:
    """Return a motion of every other family that the arm finds room for."""
    periods, out = min(_PERIODS, max(search.periods)), {}
    for kind in (k for k in KINDS if k != FOURIER):
        spec = TrajectorySpec(kind, search.seconds, periods, 100 * search.seed)
        if motion := planned(search, spec):
            out[kind] = motion
    return out


def _design(search: Search, best: Motion) -> Design:
    rng = stream(search.seed, "next/chance")
    return Design(search, best, chance(search.question, best.gram, search.twins, rng))


def _compared(search: Search, name: str, motion: Motion) -> Compared:
    return Compared(name, motion.seen.least, seconds_to(search, motion))


def document(made: Design, program: str | None) -> dict:
    """Return a design as `next_experiment` of a verdict has it, plain values.

    Args:
        program: File with the motion for a controller; None where none is written.
    """
    spec = made.best.spec
    shown: dict = {"periods": spec.periods}
    if spec.coefficients:
        shown["coefficients"] = [list(row) for row in spec.coefficients]
    else:
        shown["seed"] = spec.seed
    return {
        "rivals": [{"name": p.name, "joints": list(p.joints)} for p in made.rivals],
        "family": spec.kind,
        "parameters": shown,
        "seconds": spec.duration,
        "expected_nats": round(made.best.seen.least, 3),
        "chance": round(made.chance, 3),
        "program": program,
    }


def apart_by_no_motion(
    question: Question, twins: frozenset[Pair]
) -> tuple[list[tuple[Place, Place]], list[tuple[Place, Place]]]:
    """Return what no motion tells apart.

    Returns:
        Pairs that are one torque on every motion; and pairs of which the first is a
        case of the second, which no motion can rule out.
    """
    same, cases = {}, {}
    for c, a, b in sorted(twins):
        places = [question.contests[c].rivals[i].place for i in (a, b)]
        if (c, b, a) not in twins:
            cases[tuple(places)] = None
        elif a < b:
            same[tuple(places)] = None
    return list(same), list(cases)
