"""What a verdict says of the next experiment."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from threadpoolctl import threadpool_limits

from flows.steps.planning.design import Design, hint
from flows.steps.planning.motions import Search, with_twins
from residual.diagnosis.examine import Examined
from residual.diagnosis.findings import Named
from residual.diagnosis.result import Diagnosis, Place
from residual.evidence.fit import Fit
from residual.planning.gather import open_question
from residual.planning.outlook import HOPELESS, Pair
from residual.planning.question import Question
from residual.robot.robot import Robot

SECONDS = 20.0  # length of a motion where nobody says another [s]


@dataclass(eq=False, slots=True)
class Listener:
    """Hears what a search knows before it is let go, and keeps what is open.

    Attributes:
        question: What is open; None before the search has ended.
    """

    question: Question | None = None

    def __call__(self, examined: Examined, fitted: Fit, named: Sequence[Named]) -> None:
        """Keep what these leave open."""
        self.question = open_question(examined, fitted, named)


def suggested(found: Diagnosis, question: Question | None, robot: Robot) -> Diagnosis:
    """Return a diagnosis with the best of a few random motions as the next experiment.

    Args:
        found: The diagnosis.
        question: What it leaves open.
        robot: The arm.
    """
    if question is None or not question.contests or not found.verdict.trusted:
        return found
    with threadpool_limits(1, user_api="blas"):
        search = with_twins(Search(question, robot, SECONDS))
        made = hint(search)
    if made.best.seen.worth < HOPELESS:
        return found
    return with_next(found, document(made, None))


def with_next(found: Diagnosis, told: dict) -> Diagnosis:
    """Return a diagnosis whose verdict says what to do next."""
    return replace(found, verdict=replace(found.verdict, next_experiment=told))


def document(made: Design, program: str | None) -> dict:
    """Return a design as `next_experiment` of a verdict has it, plain values.

    Args:
        made: The design.
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
