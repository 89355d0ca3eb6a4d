"""The next experiment in the terminal: the motion, and what others would do."""

from rich.box import SIMPLE_HEAD
from rich.table import Table

from flows.report.words.outlook import (
    case_words,
    from_one_another,
    in_words,
    same_words,
)
from flows.report.words.phrases import joint_words
from flows.steps.planning.ask import Asked
from flows.steps.planning.design import Design
from flows.steps.planning.suggest import apart_by_no_motion
from residual.quantity import number, probability


def told(made: Design) -> list[str]:
    """Return what a motion settles and how surely, a sentence each."""
    spec, seen = made.best.spec, made.best.seen
    same, cases = apart_by_no_motion(made.search.question, made.search.twins)
    after = "all of it is not enough"
    if made.seconds is not None:
        after = f"enough after {made.seconds:.1f} s"
    return [
        f"next experiment: {spec.duration:g} s of {spec.kind} motion in {spec.periods} "
        f"periods, to tell {from_one_another(made.rivals)}",
        f"expected evidence: {number(seen.least)} nats between the two that are "
        f"nearest; {after} on average",
        f"chance that it settles the question: {probability(made.chance)}",
        *same_words(same),
        *case_words(cases),
        "range, speed, acceleration, torque, floor and self-collision checked between "
        "samples too",
    ]


def comparison(made: Design) -> Table:
    """Return what other motions of the same length and limits would do."""
    table = Table(box=SIMPLE_HEAD, pad_edge=False, title="same length, same limits")
    for name in ("motion", "expected nats", "enough after [s]"):
        table.add_column(name, justify="left" if name == "motion" else "right")
    rows = [("this one", made.best.seen.least, made.seconds)]
    rows += [(c.name, c.nats, c.seconds) for c in made.compared]
    for name, nats, seconds in rows:
        after = "–" if seconds is None else f"{seconds:.1f}"
        table.add_row(name, number(nats), after)
    return table


def nothing_open(asked: Asked, made: Design | None) -> list[str]:
    """Return why there is no experiment to propose.

    Args:
        made: The best motion, which promises nothing; None where nothing was asked.
    """
    question, left = asked.question, asked.found.verdict.unexplained.joints
    if made is None and left:
        return [
            f"{joint_words(left)}: more remains than noise, and nothing speaks for any "
            "candidate there, so no motion could choose among them. The page of the "
            "diagnosis shows what it depends on."
        ]
    if made is None:
        return [
            "nothing is open: no finding has an equivalent, and no joint keeps more "
            "than noise. With --want you can ask for an effect of a given size."
        ]
    same, cases = apart_by_no_motion(question, made.search.twins)
    every = [r.place for c in question.contests for r in c.rivals]
    names = ", ".join(dict.fromkeys(map(in_words, every)))
    return [
        *same_words(same),
        *case_words(cases),
        f"no motion within the limits tells {names} from one another: the best one "
        f"promises {number(made.best.seen.worth)} nats. Another load, or a value that "
        "is known for sure, may.",
    ]
