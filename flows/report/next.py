"""The next experiment in the terminal."""

from flows.report.document import Table
from flows.report.words.outlook import (
    case_words,
    from_one_another,
    in_words,
    same_words,
)
from flows.report.words.phrases import joint_words, many
from flows.steps.next import OpenVerdict, Ranking
from residual.planning.promise import separable_rivals, sure_words
from residual.quantity import MISSING, fraction, probability


def _inseparable(ranking: Ranking) -> list[str]:
    """Return rivals with one torque on every motion."""
    same, cases = {}, {}
    for c, a, b in sorted(ranking.twins):
        rivals = ranking.question.contests[c].rivals
        places = rivals[a].place, rivals[b].place
        if (c, b, a) not in ranking.twins:
            cases[places] = None
        elif a < b:
            same[places] = None
    return [*same_words(list(same)), *case_words(list(cases))]


def describe(ranking: Ranking) -> list[str]:
    """Return the question that a motion settles, and its chance, in sentences."""
    best, spec = ranking.best, ranking.best.spec
    rivals = from_one_another(separable_rivals(ranking.question, best.outlook))
    words = sure_words(spec.duration, best.after, best.prospect.chance)
    return [
        f"next experiment: {spec.duration:g} s of {spec.kind} motion in "
        f"{many(spec.periods, 'period')}, to tell {rivals}",
        f"the question is {words}",
        *_inseparable(ranking),
        "range, speed, acceleration, torque, floor and self-collision are checked, "
        "also between samples; check tools, cables, fixtures and fences yourself",
    ]


def comparison(ranking: Ranking) -> Table:
    """Return the best motions of the same length and limits."""
    rows = [
        (
            m.spec.kind.replace("_", " "),
            many(m.spec.periods, "period"),
            MISSING if m.after is None else f"{m.after:.1f} s",
            probability(m.prospect.chance),
        )
        for m in ranking.ranked
    ]
    heads = ("motion", "", "settled after", "chance by all of it")
    return Table(heads, rows, "the first one is proposed; same length, same limits")


def nothing_open(opened: OpenVerdict, ranking: Ranking | None) -> list[str]:
    """Return why there is no experiment to propose, with a ranking or without."""
    left = opened.diagnosis.verdict.unexplained.joints
    if ranking is None and left:
        return [
            f"{joint_words(left)}: the residual exceeds the noise, but no candidate "
            "has evidence there, so no motion could choose among candidates. The page "
            "of the diagnosis shows what the residual depends on."
        ]
    if ranking is None:
        return [
            "nothing is open: no finding has an equivalent, and no residual exceeds "
            "the noise."
        ]
    every = [r.place for c in opened.question.contests for r in c.rivals]
    names = ", ".join(dict.fromkeys(map(in_words, every)))
    return [
        *_inseparable(ranking),
        f"no feasible motion separates {names}: the best one brings "
        f"{fraction(ranking.best.outlook.share)} of the evidence that is needed; try a "
        "different payload, or supply a known value (--known)",
    ]
