"""The next experiment in the terminal."""

from flows.report.document import ReportTable
from flows.report.phrases import count_noun, joint_words, sentence_case
from flows.report.sentences import from_one_another, in_words
from flows.steps.next import OpenVerdict, Ranking
from residual.planning.promise import separable_rivals, sure_words
from residual.quantity import MISSING, fraction, probability


def _inseparable(ranking: Ranking) -> list[str]:
    """Return which rivals are the same torque, and which no motion rules out."""
    lines = {}
    for c, a, b in sorted(ranking.twins):
        rivals = ranking.question.contests[c].rivals
        one, other = in_words(rivals[a].place), in_words(rivals[b].place)
        start = sentence_case(one)
        if (c, b, a) not in ranking.twins:
            lines[
                f"{start} is a special case of {other}: a motion can rule out the "
                "first, never the second."
            ] = None
        elif a < b:
            lines[
                f"{start} and {other} are the same torque on every motion, at the "
                "identified size: no experiment separates them."
            ] = None
    return [*lines]


def proposal_lines(ranking: Ranking) -> list[str]:
    """Return the question that a motion settles, and its chance, a sentence each."""
    best, spec = ranking.best, ranking.best.spec
    rivals = from_one_another(separable_rivals(ranking.question, best.outlook))
    words = sure_words(spec.duration, best.after, best.prospect.chance)
    return [
        f"Next experiment: {spec.duration:g} s of {spec.kind} motion in "
        f"{count_noun(spec.periods, 'period')}, to separate {rivals}.",
        f"The question is {words}.",
        *_inseparable(ranking),
        "Range, speed, acceleration, torque, floor and self-collision are within "
        "limits also between samples; tools, cables and fences are not checked.",
    ]


def comparison(ranking: Ranking) -> ReportTable:
    """Return the ranked motions of the same length and limits."""
    rows = [
        (
            m.spec.kind.replace("_", " "),
            count_noun(m.spec.periods, "period"),
            MISSING if m.after is None else f"{m.after:.1f} s",
            probability(m.prospect.chance),
        )
        for m in ranking.ranked
    ]
    heads = ("motion", "periods", "settled after", "chance by its end")
    title = "Motions of the same length within the same limits, best first"
    return ReportTable(heads, rows, title)


def nothing_open(opened: OpenVerdict, ranking: Ranking | None) -> list[str]:
    """Return why there is no experiment to propose.

    Args:
        ranking: Its best motion decides nothing; None where there is no question.
    """
    flagged = opened.diagnosis.verdict.unexplained.joints
    if ranking is None and flagged:
        return [
            f"The residual on {joint_words(flagged)} is larger than noise, but no "
            "candidate effect explains any of it, so no motion could choose among "
            "them. The report of the diagnosis shows what it depends on."
        ]
    if ranking is None:
        return [
            "Nothing is open: no finding has an equivalent, and no joint has a "
            "residual larger than noise."
        ]
    every = [r.place for c in opened.question.contests for r in c.rivals]
    names = ", ".join(dict.fromkeys(map(in_words, every)))
    return [
        *_inseparable(ranking),
        f"No feasible motion separates {names}: the best one yields "
        f"{fraction(ranking.best.outlook.share)} of the evidence needed. Try a "
        "different payload or supply a known value (--known).",
    ]
