"""Motions within the limits of an arm that may answer a question, and their course."""

from dataclasses import dataclass, replace

import numpy as np

from residual.errors import InputError
from residual.planning.outlook import Outlook, Pair, Prospect, outlook
from residual.planning.promise import (
    Course,
    structural_twins,
    sure_after,
    until_apart,
)
from residual.planning.question import Question
from residual.robot.robot import Robot
from sim.engine.records import TrajectorySpec, stream
from sim.trajectories.curves import Series
from sim.trajectories.fourier import DIGITS, draw, sampled, written
from sim.trajectories.limits import Plan, Workspace, workspace
from sim.trajectories.move_stop_move import given_places, round_time
from sim.trajectories.reference import make_plan

Array = np.ndarray

FOURIER, MOVES = "fourier", "move_stop_move"
PERIODS = (2.5, 5.0, 10.0)  # s, of Fourier motions, about; all are tried
PLACES = (2, 3)  # of a move-stop-move, tried in turn
_MOVING = 0.5  # chance that a joint takes part in a move
# Samples of a motion per row of a log: where it is one of many, and looked at closely.
COARSER, FINER = 0.5, 2


@dataclass(frozen=True, eq=False, slots=True)
class Motion:
    """A motion, and what it promises.

    Attributes:
        spec: The motion; made again from it, it is the same.
        period: Length of what it repeats [s].
        seen: What all of it brings at the sizes that were found.
        sure: What all of it brings, counted in drawn logs.
        after: After how long of it the question is settled surely [s]; None where all
            of it is not enough.
    """

    spec: TrajectorySpec
    period: float
    seen: Outlook
    sure: Prospect
    after: float | None

    @property
    def rank(self) -> tuple[float, float]:
        """Less is better: soon sure; where never, a small chance not to be."""
        return np.inf if self.after is None else self.after, -self.sure.chance


@dataclass(frozen=True, eq=False, slots=True)
class Search:
    """A question, an arm, and how long a motion may take.

    Attributes:
        question: What is asked.
        robot: The arm.
        seconds: Length of the motion at most [s].
        seed: Seed of all that is drawn.
        twins: Pairs that no motion tells apart.
    """

    question: Question
    robot: Robot
    seconds: float
    seed: int = 0
    twins: frozenset[Pair] = frozenset()

    def workspace(self, periods: int = 1) -> Workspace:
        """Return the arm's limits, for so many periods."""
        return workspace(self.robot, self.seconds / periods)

    @property
    def periods(self) -> tuple[int, ...]:
        """Numbers of periods of Fourier motions to try, fewest first."""
        return tuple(sorted({max(1, round(self.seconds / p)) for p in PERIODS}))

    def until_apart(self, course: Course, seconds: float) -> float:
        """Return after how long of a motion all pairs should be apart [s]."""
        return until_apart(self.question, course, seconds, self.twins)


def with_twins(search: Search) -> Search:
    """Return the same search with the pairs left out that no motion tells apart."""
    return replace(search, twins=structural_twins(search.question))


def series_course(
    search: Search, place: Workspace, series: Series, finer: float = COARSER
) -> Course:
    """Return the course of a Fourier motion, by one of its periods."""
    count = round(place.period * finer * search.question.signals.rate)
    motion = sampled(series, np.arange(count) / count * place.period)
    return Course.of(search.question, motion, count / place.period)


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
    course = series_course(search, place, series, FINER)
    return _motion(search, spec, place.period, course)


def drawn_places(search: Search, count: int) -> list[Array]:
    """Return postures for moves between them [rad], some joints moving. (k, dof)."""
    rng, limits = stream(search.seed, "next/places"), search.workspace().limits
    out, dof = [], search.robot.dof
    for i in range(count):
        shares = rng.uniform(-1, 1, (PLACES[i % len(PLACES)], dof))
        still = rng.random(dof) > _MOVING
        shares[:, still] = shares[0, still]
        out.append(limits.middle + shares * limits.half)
    return out


def moves_plan(
    search: Search, space: Workspace, places: Array, stand: float
) -> tuple[TrajectorySpec, Plan] | None:
    """Return moves round some places, as often as there is time; None for no way.

    Args:
        places: Postures [rad]. Shape (k, dof).
        stand: How long they begin by standing at the first, at least [s].
    """
    rows = np.round(places, DIGITS) + 0.0
    one = round_time(space, rows)
    if one is None or (rounds := int((search.seconds - stand) / one)) < 1:
        return None
    length = min(np.ceil(10 * (stand + rounds * one)) / 10, search.seconds)
    numbers = tuple(map(tuple, rows.tolist()))
    spec = TrajectorySpec(MOVES, float(length), rounds, 0, numbers)
    return spec, given_places(search.robot, spec.duration, rounds, numbers)


def planned(search: Search, spec: TrajectorySpec) -> Motion | None:
    """Return a motion of any family; None where the arm finds no room for it."""
    try:
        plan = make_plan(search.robot, spec)
    except InputError:
        return None
    return _motion(search, spec, plan.period, plan_course(search, plan, FINER))


def plan_course(search: Search, plan: Plan, finer: float = COARSER) -> Course:
    """Return the course of a planned motion, by what of it does not repeat."""
    rate = finer * search.question.signals.rate
    motion = plan.curve(np.arange(round(plan.once * rate)) / rate)
    opening = max(plan.once - plan.period, 0.0)
    return Course.of(search.question, motion, rate, opening)


def _motion(
    search: Search, spec: TrajectorySpec, period: float, course: Course
) -> Motion:
    question, twins, seconds = search.question, search.twins, spec.duration
    seen = outlook(question, course.gram(seconds), twins)
    sure, after = sure_after(question, course, seconds, twins)
    return Motion(spec, period, seen, sure, after)
