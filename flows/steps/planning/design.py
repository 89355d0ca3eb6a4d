"""The motion that answers a question soonest, and what the usual ones would do."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from flows.outputs import Progress
from flows.steps.planning.motions import (
    FOURIER,
    Motion,
    Search,
    drawn,
    drawn_places,
    fourier,
    moves_plan,
    plan_course,
    planned,
    series_course,
    with_twins,
)
from residual.diagnosis.result import Place
from residual.planning.outlook import Pair
from residual.planning.promise import said, told_apart
from residual.planning.question import Question
from residual.robot.robot import Robot
from residual.threads import one_blas_thread
from sim.engine.records import TrajectorySpec
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
_NEVER = 1e4  # s: of a motion that is not possible


@dataclass(frozen=True, eq=False, slots=True)
class Form:
    """A Fourier motion as numbers near one: centres, form and size of every joint.

    Attributes:
        search: What is looked for.
        place: The arm's limits.
    """

    search: Search
    place: Workspace

    def numbers(self, series: Series) -> Array:
        """Return the numbers of a motion. Shape (10 dof,)."""
        limits, free = self.place.limits, free_of(series)
        centre = (series.centre - limits.middle) / limits.half
        size = 1 / np.maximum(room_left(self.place, series), 1.0)
        form = free / np.maximum(np.linalg.norm(free, axis=0), 1e-12)
        return np.concatenate([centre, form.ravel(), size])

    def series(self, x: Array) -> Series | None:
        """Return the motion of some numbers, roughly within limits; None for none."""
        limits, dof = self.place.limits, self.search.robot.dof
        centre = limits.middle + np.clip(x[:dof], -_REACH, _REACH) * limits.half
        free = x[dof:-dof].reshape(FREE, dof)
        whole = largest(self.place, Series(centre, *harmonics(free), self.place.period))
        share = np.clip(x[-dof:], _SMALLEST, 1.0)
        return fit_in(self.place, shrunk(whole, share), roughly=True)

    def seconds(self, series: Series) -> float:
        """Return after how long of a motion all pairs should be apart [s]."""
        course = series_course(self.search, self.place, series)
        return self.search.until_apart(course, self.search.seconds)

    def cost(self, x: Array) -> float:
        """Return what a better motion makes smaller: ln of its seconds."""
        series = self.series(x)
        return float(np.log(_NEVER if series is None else self.seconds(series)))


@dataclass(frozen=True, eq=False, slots=True)
class Moves:
    """Moves round some places, as shares of the range of every joint.

    Attributes:
        search: What is looked for.
        space: The arm's limits.
        stand: How long they begin by standing [s].
    """

    search: Search
    space: Workspace
    stand: float

    def numbers(self, places: Array) -> Array:
        """Return the numbers of some places. Shape (k dof,)."""
        limits = self.space.limits
        return ((places - limits.middle) / limits.half).ravel()

    def places(self, x: Array) -> Array:
        """Return the places of some numbers [rad]. Shape (k, dof)."""
        limits = self.space.limits
        shares = np.clip(x, -1, 1).reshape(-1, self.search.robot.dof)
        return limits.middle + shares * limits.half

    def cost(self, x: Array) -> float:
        """Return what better places make smaller: ln of their seconds."""
        made = moves_plan(self.search, self.space, self.places(x), self.stand)
        if made is None:
            return float(np.log(_NEVER))
        course = plan_course(self.search, made[1])
        return float(np.log(self.search.until_apart(course, made[0].duration)))


def descend(cost: Callable[[Array], float], start: Array, looks: int) -> Array:
    """Return what a local search makes of some numbers."""
    found = minimize(
        cost,
        start,
        method="COBYLA",  # the worst of several pairs has kinks: no derivatives
        options={"maxiter": looks, "rhobeg": _REGION},
    )
    return found.x


def improve(search: Search, place: Workspace, series: Series, looks: int) -> Series:
    """Return a Fourier motion that is sooner sure, by a local search from one."""
    form = Form(search, place)
    better = form.series(descend(form.cost, form.numbers(series), looks))
    exact = None if better is None else fit_in(place, better)
    return series if exact is None else exact


MANY = 40  # random motions of each kind
_LOOKS = 120  # motions that a local search may look at
_PERIODS = 2  # of motions that nobody designed: what a specification has by default

RANDOM = "random fourier"


@dataclass(frozen=True, slots=True)
class Compared:
    """What a usual motion of the same length and limits would do.

    Attributes:
        name: What it is.
        chance: Chance that all of it settles the question.
        seconds: After how long it is surely settled [s]; None where all of it is not
            enough.
    """

    name: str
    chance: float
    seconds: float | None


@dataclass(frozen=True, eq=False, slots=True)
class Design:
    """A motion for a question.

    Attributes:
        search: What it answers.
        best: The motion.
        compared: What others would do.
    """

    search: Search
    best: Motion
    compared: tuple[Compared, ...] = ()

    @property
    def rivals(self) -> tuple[Place, ...]:
        """What the motion tells apart, each once."""
        return told_apart(self.search.question, self.best.seen)


@one_blas_thread
def answer(
    question: Question,
    robot: Robot,
    seconds: float,
    seed: int,
    tell: Progress | None = None,
) -> "Design | None":
    """Return the best motion for what is open; None where nothing is.

    Args:
        seconds: The longest that it may take [s].
    """
    if not question.contests:
        return None
    return design(with_twins(Search(question, robot, seconds, seed)), tell)


def design(search: Search, tell: Progress | None = None) -> Design:
    """Return the motion that is soonest sure of all that a seeded search finds.

    Random Fourier motions and random places are ranked by a coarse look; a local search
    improves the best of either; of every other family one motion is drawn.
    """
    tell = tell or (lambda stage, share: None)
    tell("Fourier motions", 0.0)
    usual, waves = _fourier_motions(search)
    tell("moves between places", 0.5)
    moves = _moves(search)
    tell("other motions", 0.9)
    named = {RANDOM: usual, **_families(search)}
    every = [*waves, *moves, *list(named.values())[1:]]
    best = min(every, key=lambda motion: motion.rank)
    compared = [Compared(n, m.sure.chance, m.after) for n, m in named.items()]
    tell("other motions", 1.0)
    return Design(search, best, tuple(compared))


def _fourier_motions(search: Search) -> tuple[Motion, list[Motion]]:
    """Return a usual one of the random Fourier motions; the best, and a better one."""
    motions = drawn(search, MANY)
    seconds = [Form(search, place).seconds(series) for place, series in motions]
    order = sorted(range(MANY), key=seconds.__getitem__)
    periods = min(search.periods, key=lambda n: abs(n - _PERIODS))
    plain = [
        i for i in order if round(search.seconds / motions[i][0].period) == periods
    ]
    place, series = motions[order[0]]
    better = improve(search, place, series, _LOOKS)
    found = [fourier(search, place, one) for one in (series, better)]
    return fourier(search, *motions[plain[len(plain) // 2]]), found


def _moves(search: Search) -> list[Motion]:
    """Return the best of moves round random places, and a better one.

    They stand while the filter of a log settles, or are under way by then: what is
    sooner sure.
    """
    space = search.workspace()
    forms = [Moves(search, space, x) for x in (0.0, search.question.signals.edge)]
    starts = [forms[0].numbers(places) for places in drawn_places(search, MANY)]
    every = [(form.cost(x), i, form, x) for i, x in enumerate(starts) for form in forms]
    _, _, form, start = min(every, key=lambda one: one[:2])
    out = []
    for x in (start, descend(form.cost, start, _LOOKS)):
        made = moves_plan(search, space, form.places(x), form.stand)
        found = planned(search, made[0]) if made else None
        out += [found] if found else []
    return out


def _families(search: Search) -> dict[str, Motion]:
    """Return a motion of every other family that the arm finds room for."""
    out = {}
    for kind in (k for k in KINDS if k != FOURIER):
        spec = TrajectorySpec(kind, search.seconds, _PERIODS, 100 * search.seed)
        if motion := planned(search, spec):
            out[kind] = motion
    return out


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
        **said(made.best.sure, made.best.after),
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
