"""What a verdict says of the next experiment, once a motion was designed for it."""

from flows.steps.planning.design import Design
from residual.diagnosis.result import Place
from residual.planning.outlook import Pair
from residual.planning.question import Question


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
