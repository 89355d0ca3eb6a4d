"""Which motion of the built-in families settles soonest what a verdict leaves open."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from flows.outputs import Progress
from residual.diagnosis.result import Place
from residual.errors import InputError
from residual.planning.outlook import Outlook, Pair, Prospect, outlook
from residual.planning.promise import (
    Course,
    said,
    structural_twins,
    sure_after,
    told_apart,
    until_apart,
)
from residual.planning.question import Question
from residual.robot.robot import Robot
from residual.threads import one_blas_thread
from sim.engine.records import TrajectorySpec, stream
from sim.trajectories.fourier import draw, written
from sim.trajectories.limits import workspace
from sim.trajectories.reference import make_plan

# Families that excite the arm. Those that follow a workpiece take a second or two to
# plan and move as the piece lies.
FOURIER, MOVES = "fourier", "move_stop_move"
PERIODS = (2.5, 5.0, 10.0)  # s, of the motions, about
WAVES, PLACES = 12, 4  # motions of each period, of either family
LOOKS = 4  # motions that are looked at closely
# Samples of a motion per row of a log: where it is one of many, and looked at closely.
COARSER, FINER = 0.5, 2


@dataclass(frozen=True, eq=False, slots=True)
class Motion:
    """A motion, and what it promises.

    Attributes:
        spec: The motion; planned again from it, it is the same.
        seen: What all of it brings at the sizes that were found.
        sure: What all of it brings, counted in drawn logs.
        after: After how long of it the question is settled surely [s]; None where all
            of it is not enough.
    """

    spec: TrajectorySpec
    seen: Outlook
    sure: Prospect
    after: float | None

    @property
    def rank(self) -> tuple[float, float]:
        """Less is better: soon sure; where never, a small chance not to be."""
        return np.inf if self.after is None else self.after, -self.sure.chance


@dataclass(frozen=True, eq=False, slots=True)
class Design:
    """Motions for a question.

    Attributes:
        question: What is open.
        twins: Pairs that no motion tells apart.
        ranked: The motions that were looked at closely, the best first.
    """

    question: Question
    twins: frozenset[Pair]
    ranked: tuple[Motion, ...]

    @property
    def best(self) -> Motion:
        """The one to run."""
        return self.ranked[0]

    @property
    def rivals(self) -> tuple[Place, ...]:
        """What the motion tells apart, each once."""
        return told_apart(self.question, self.best.seen)


@one_blas_thread
def design(
    question: Question,
    robot: Robot,
    seconds: float,
    seed: int,
    tell: Progress | None = None,
) -> Design | None:
    """Rank motions of both families; None where nothing is open, or none is found.

    Each is weighed by how much of it all pairs need to be apart at the sizes that were
    found; of the best few it is counted in drawn logs after how long they are surely.

    Args:
        seconds: Length of the motion [s].
        seed: Seed of all that is drawn.
    """
    if not question.contests:
        return None
    tell = tell or (lambda stage, share: None)
    twins, every = structural_twins(question), list(_specs(robot, seconds, seed))
    weighed = []
    for i, spec in enumerate(every):
        tell("motions", i / len(every))
        course = _course(question, robot, spec, COARSER)
        if course is not None:
            weighed.append((until_apart(question, course, seconds, twins), i))
    best = sorted(weighed)[:LOOKS]
    looked = [_motion(question, robot, every[i], twins) for _, i in best]
    tell("motions", 1.0)
    ranked = tuple(sorted(looked, key=lambda motion: motion.rank))
    return Design(question, twins, ranked) if ranked else None


def _specs(robot: Robot, seconds: float, seed: int) -> Iterator[TrajectorySpec]:
    """Motions of both families: of several periods, each drawn some times."""
    rng = stream(seed, "next/fourier")
    for periods in sorted({max(1, round(seconds / p)) for p in PERIODS}):
        place = workspace(robot, seconds / periods)
        for _ in range(WAVES):
            rows = written(draw(place, rng))
            yield TrajectorySpec(FOURIER, seconds, periods, 0, rows)
        for i in range(PLACES):
            yield TrajectorySpec(MOVES, seconds, periods, 100 * seed + i)


def _course(
    question: Question, robot: Robot, spec: TrajectorySpec, finer: float
) -> Course | None:
    """Return the course of a motion; None where the arm finds no room for it."""
    try:
        plan = make_plan(robot, spec)
    except InputError:
        return None
    rate = finer * question.signals.rate
    motion = plan.curve(np.arange(round(plan.once * rate)) / rate)
    return Course.of(question, motion, rate, max(plan.once - plan.period, 0.0))


def _motion(
    question: Question, robot: Robot, spec: TrajectorySpec, twins: frozenset[Pair]
) -> Motion:
    course = _course(question, robot, spec, FINER)
    assert course is not None
    seen = outlook(question, course.gram(spec.duration), twins)
    return Motion(spec, seen, *sure_after(question, course, spec.duration, twins))


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
