"""The next experiment in words: what it settles, how surely, and how to run it."""

from collections.abc import Mapping, Sequence

from flows.report.words.phrases import listing, phrase
from residual.diagnosis.result import Place, Verdict
from residual.names import joints_listed
from residual.planning.question import NOTHING, TOGETHER
from residual.quantity import known, number, probability

_FAMILIES = {
    "fourier": "a Fourier motion",
    "cyclic": "a painting motion",
    "welding": "a welding motion",
    "move_stop_move": "a pick-and-place motion",
}

_OFFER = (
    "modelgap next looks for a motion that tells apart what these logs cannot, and "
    "says where none does"
)


def next_words(verdict: Verdict) -> list[str]:
    """Return what a verdict proposes, a sentence each; none where nothing is open."""
    plan = verdict.next_experiment
    if not plan:
        alike = any(finding.equivalent for finding in verdict.effects)
        return [_OFFER] if alike else []
    apart = from_one_another([_place(p) for p in plan["rivals"]])
    if plan["family"] is None:
        return [_promise(plan, apart)]
    periods = plan["parameters"].get("periods")
    times = f" in {periods} periods" if periods else ""
    family = _FAMILIES.get(plan["family"], f"a motion of kind {plan['family']}")
    out = [f"{family} of {number(plan['seconds'])} s{times} tells {apart}"]
    if known(plan["expected_nats"]):
        out.append(
            f"expected evidence between the two that are nearest: "
            f"{number(plan['expected_nats'])} nats"
        )
    if known(plan["chance"]):
        sure = probability(plan["chance"])
        out.append(f"chance that it settles the question: {sure}")
    if plan["program"]:
        out.append(f"program for the controller: {plan['program']}")
    else:
        out.append("modelgap next finds a better one, and writes it for a controller")
    return out


def _promise(plan: Mapping, apart: str) -> str:
    """What a free motion would tell, where none was designed yet."""
    nats = plan["expected_nats"]
    worth = f", by {number(nats)} nats at the nearest" if known(nats) else ""
    return (
        f"{number(plan['seconds'])} s of another motion may tell {apart}{worth} where "
        "nothing is in its way: modelgap next designs it for this arm"
    )


def _place(entry: Mapping) -> Place:
    return Place(entry["name"], tuple(entry["joints"]))


def from_one_another(rivals: Sequence[Place]) -> str:
    """Return rivals in words: 'a spring on joint 2 from an offset on joint 2'."""
    words = [in_words(place) for place in rivals]
    if len(words) == 2:
        return f"{words[0]} from {words[1]}"
    return f"{listing(words)} from one another"


def in_words(place: Place) -> str:
    """Return a rival in words."""
    if place == NOTHING:
        return "nothing at all"
    if TOGETHER not in place.name:
        return phrase(place)
    names = listing(place.name.split(TOGETHER))
    return f"{names} together on {joints_listed(place.joints)}"


def same_words(pairs: Sequence[tuple[Place, Place]]) -> list[str]:
    """Return which rivals are one torque on every motion, a sentence each."""
    return [
        f"{in_words(a)} and {in_words(b)} are the same torque on every motion within "
        "the limits: no experiment tells them apart"
        for a, b in pairs
    ]


def case_words(pairs: Sequence[tuple[Place, Place]]) -> list[str]:
    """Return which rivals are a case of another, a sentence each."""
    return [
        f"{in_words(a)} is a case of {in_words(b)}: a motion can rule out the first "
        "and never the second"
        for a, b in pairs
    ]
