"""Motions within the limits of an arm that may answer a question, and their Gram."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from residual.errors import InputError
from residual.planning.outlook import (
    Outlook,
    Pair,
    has_enough,
    outlook,
    structural_twins,
)
from residual.planning.promise import growing_grams, planned_gram
from residual.planning.question import Question
from residual.robot.robot import Robot
from sim.engine.records import TrajectorySpec, stream
from sim.trajectories.curves import Series
from sim.trajectories.fourier import draw, sampled, written
from sim.trajectories.limits import Plan, Workspace, workspace
from sim.trajectories.reference import make_plan

Array = np.ndarray
Curve = Callable[[Array], tuple[Array, Array, Array]]

FOURIER = "fourier"
PERIODS = (2, 4)  # of a motion, tried in turn
LEAST_PERIOD = 2.5  # s
FREE = 6  # motions that tell what is the same on every motion
STEP = 0.5  # s, in which it is said when a motion has brought enough
# Samples of a motion per row of a log: where it is one of many, and looked at closely.
COARSER, FINER = 0.5, 2


@dataclass(frozen=True, eq=False, slots=True)
class Motion:
    """A motion, and what it promises.

    Attributes:
        spec: The motion; made again from it, it is the same.
        gram: Whitened Gram of the shared columns. Shape (m, m).
        seen: What it promises.
        curve: q, qd and qdd at any times.
    """

    spec: TrajectorySpec
    gram: Array
    seen: Outlook
    curve: Curve


@dataclass(frozen=True, eq=False, slots=True)
class Search:
    """A question, an arm, and how long a motion may take.

    Attributes:
        question: What is asked.
        robot: The arm.
        seconds: Length of the motion [s].
        seed: Seed of all that is drawn.
        twins: Pairs that no motion tells apart.
    """

    question: Question
    robot: Robot
    seconds: float
    seed: int = 0
    twins: frozenset[Pair] = frozenset()

    def workspace(self, periods: int) -> Workspace:
        """Return the arm's limits, for so many periods."""
        return workspace(self.robot, self.seconds / periods)

    @property
    def periods(self) -> tuple[int, ...]:
        """Numbers of periods to try."""
        most = max(1, int(self.seconds / LEAST_PERIOD))
        return tuple(sorted({min(count, most) for count in PERIODS}))

    def weighed(self, gram: Array) -> Outlook:
        """Return what a motion with such a Gram promises."""
        return outlook(self.question, gram, self.twins)


def with_twins(search: Search) -> Search:
    """Return the same search with the pairs left out that are one on every motion."""
    rng = stream(search.seed, "next/free")
    place = search.workspace(search.periods[0])
    grams = [series_gram(search, place, draw(place, rng)) for _ in range(FREE)]
    return replace(search, twins=structural_twins(search.question, grams))


def series_gram(
    search: Search, place: Workspace, series: Series, finer: float = 1.0
) -> Array:
    """Return the Gram of a Fourier motion, by one of its periods. Shape (m, m)."""
    rate = finer * search.question.signals.rate
    count = round(place.period * rate)
    t = np.arange(count) / count * place.period
    motion = sampled(series, t)
    return planned_gram(search.question, motion, count / place.period, search.seconds)


def drawn(search: Search, count: int) -> list[tuple[Workspace, Series]]:
    """Return random Fourier motions, as large as the limits let them."""
    rng, places = stream(search.seed, "next/fourier"), []
    every = [search.workspace(n) for n in search.periods]
    for i in range(count):
        place = every[i % len(every)]
        places.append((place, draw(place, rng)))
    return places


def fourier(search: Search, place: Workspace, series: Series) -> Motion:
    """Return a Fourier motion by its numbers, looked at closely."""
    periods = round(search.seconds / place.period)
    spec = TrajectorySpec(FOURIER, search.seconds, periods, 0, written(series))
    gram = series_gram(search, place, series, FINER)
    return Motion(spec, gram, search.weighed(gram), lambda t: sampled(series, t))


def planned(search: Search, spec: TrajectorySpec) -> Motion | None:
    """Return a motion of any family; None where the arm finds no room for it."""
    try:
        plan = make_plan(search.robot, spec)
    except InputError:
        return None
    gram = plan_gram(search, plan)
    return Motion(spec, gram, search.weighed(gram), plan.curve)


def plan_gram(search: Search, plan: Plan) -> Array:
    """Return the Gram of a planned motion, by what of it does not repeat. (m, m)."""
    rate = FINER * search.question.signals.rate
    motion = plan.curve(np.arange(round(plan.once * rate)) / rate)
    return planned_gram(search.question, motion, rate, search.seconds)


def seconds_to(search: Search, motion: Motion) -> float | None:
    """Return after how long of a motion every pair is expected to have enough [s].

    Returns:
        None where all of it is not enough.
    """
    rate, until = search.question.signals.rate, np.arange(STEP, search.seconds, STEP)
    t = np.arange(round(search.seconds * rate)) / rate
    until = [*until, search.seconds - search.question.signals.edge]
    grams = growing_grams(search.question, motion.curve(t), rate, until)
    enough = (
        end
        for end, gram in zip(until, grams, strict=True)
        if has_enough(search.question, gram, search.twins)
    )
    return next(enough, None)
