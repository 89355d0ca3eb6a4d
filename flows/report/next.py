"""The next experiment in the terminal."""

from flows.report.document import Table
from flows.report.words.outlook import (
    case_words,
    from_one_another,
    in_words,
    same_words,
)
from flows.report.words.phrases import joint_words, many
from flows.steps.next import Opened, Ranking
from residual.planning.promise import sure_words, told_apart
from residual.quantity import MISSING, fraction, probability


def _inseparable(ranking: Ranking) -> list[str]:
    """Return what is one torque on every motion, and what no motion rules out."""
    same, cases = {}, {}
    for c, a, b in sorted(ranking.twins):
        rivals = ranking.question.contests[c].rivals
        places = rivals[a].place, rivals[b].place
        if (c, b, a) not in ranking.twins:
            cases[places] = None
        elif a < b:
            same[places] = None
    return [*same_words(list(same)), *case_words(list(cases))]


def told(ranking: Ranking) -> list[str]:
    """Return what a motion settles and how surely, a sentence each."""
    best, spec = ranking.best, ranking.best.spec
    rivals = from_one_another(told_apart(ranking.question, best.seen))
    words = sure_words(spec.duration, best.after, best.sure.chance)
    return [
        f"next experiment: {spec.duration:g} s of {spec.kind} motion in "
        f"{many(spec.periods, 'period')}, to tell {rivals}",
        f"the question is {words}",
        *_inseparable(ranking),
        "range, speed, acceleration, torque, floor and self-collision checked between "
        "samples too; tools, cables, fixtures and fences are not known here",
    ]


def comparison(ranking: Ranking) -> Table:
    """Return what other motions of the same length and limits would do."""
    rows = [
        (
            m.spec.kind.replace("_", " "),
            many(m.spec.periods, "period"),
            MISSING if m.after is None else f"{m.after:.1f} s",
            probability(m.sure.chance),
        )
        for m in ranking.ranked
    ]
    heads = ("motion", "", "settled after", "chance by all of it")
    return Table(heads, rows, "the first is the one; same length, same limits")


def nothing_open(opened: Opened, ranking: Ranking | None) -> list[str]:
    """Return why there is no experiment to propose.

    Args:
        ranking: Its best motion promises nothing; None where nothing was asked.
    """
    left = opened.found.verdict.unexplained.joints
    if ranking is None and left:
        return [
            f"{joint_words(left)}: more remains than noise, and nothing speaks for any "
            "candidate there, so no motion could choose among them. The page of the "
            "diagnosis shows what it depends on."
        ]
    if ranking is None:
        return [
            "nothing is open: no finding has an equivalent, and no joint keeps more "
            "than noise."
        ]
    every = [r.place for c in opened.question.contests for r in c.rivals]
    names = ", ".join(dict.fromkeys(map(in_words, every)))
    return [
        *_inseparable(ranking),
        f"no motion within the limits tells {names} from one another: the best one "
        f"brings {fraction(ranking.best.seen.share)} of the evidence that is needed. "
        "Another load, or a value that is known for sure, may.",
    ]
