"""What the findings leave open: the rest, what was too small to see, what is next."""

from collections.abc import Mapping, Sequence

from flows.report.words.phrases import (
    count,
    joint_words,
    listing,
    many,
    phrase,
    sentence_case,
)
from residual.diagnosis.result import (
    LOAD,
    MOTION,
    Alternative,
    Change,
    Dependence,
    Place,
    Unexplained,
    Verdict,
)
from residual.errors import joints_listed
from residual.planning.promise import sure_words
from residual.planning.question import NOTHING, TOGETHER
from residual.quantity import MISSING, fraction, known, measured, number, unit_text

NEVER = "n.d."  # not detectable here: it would take more than an arm can have
_ELSEWHERE = 10**6  # column of what does not sit on one joint: after every joint


def detectable_rows(verdict: Verdict) -> tuple[list[str], list[list[str]]]:
    """Return (heading, rows): smallest size that would have been found, per joint.

    Effects on pairs of joints or on the whole arm get rows and a column of their own.
    """
    sizes: dict[tuple[str, str], dict[int, str]] = {}
    for item in verdict.minimum_detectable:
        local = len(item.joints) == 1
        name = " ".join([*item.name.split("_"), *map(str, item.joints[local:])])
        column = item.joints[0] if local else _ELSEWHERE
        row = sizes.setdefault((name, unit_text(item.unit)), {})
        row[column] = NEVER if item.value is None else _size(item.value)
    columns = sorted({column for found in sizes.values() for column in found})
    heads = ["else" if c == _ELSEWHERE else f"J{c}" for c in columns]
    rows = [
        [name, unit, *(found.get(c, MISSING) for c in columns)]
        for (name, unit), found in sizes.items()
    ]
    return ["Effect", "Unit", *heads], rows


def _size(value: float) -> str:
    return f"{value:.2g}" if value < 100 else number(value)


def unexplained_words(verdict: Verdict) -> list[str]:
    """Return what is left after the findings, in sentences."""
    left = verdict.unexplained
    words = []
    if known(left.fraction):
        sentence = f"{fraction(left.fraction)} of the torque stays unexplained"
        if known(left.noise_floor):
            sentence += f"; noise alone is {fraction(left.noise_floor)}"
            sentence += f" (from {left.noise_model})" if left.noise_model else ""
        words.append(f"{sentence}.")
    if left.joints:
        who = sentence_case(joint_words(left.joints, verdict.dof))
        words.append(f"{who}: too much is left to call the model complete.")
    if left.kind:
        words.append(f"What is left is {left.kind}.")
    return words + _dependences(left)


def _dependences(left: Unexplained) -> list[str]:
    """Return what the rest of each joint depends on, one sentence per joint."""
    known_joints = list(dict.fromkeys(entry.joint for entry in left.depends_on))
    words = []
    for joint in known_joints:
        own = [_dependence(e) for e in left.depends_on if e.joint == joint]
        words.append(f"Of what joint {joint} keeps, {listing(own)}.")
    lost = [j for j in left.joints if j not in known_joints]
    if lost:
        who = joint_words(lost)
        words.append(f"What the rest on {who} depends on is not known.")
    return words


def _dependence(entry: Dependence) -> str:
    share = fraction(entry.share)
    if entry.on == "frequency":
        return f"{share} swings at {number(entry.frequency)} Hz"
    turned = " with the sign of the motion" if entry.form == "by direction" else ""
    if entry.on == "t":
        return f"{share} drifts with time{turned}"
    sign = " - " if entry.form == "difference" else " + "
    variable = sign.join(f"{entry.on}{joint}" for joint in entry.of)
    return f"{share} follows {variable}{turned}"


_SHOWN = 3
Key = tuple[str, tuple[int, ...]]


def other_sets(verdict: Verdict) -> list[str]:
    """Return sentences on what else it could be, and what would tell.

    Sets in which one finding gives way to its equivalent are said with that finding.
    """
    known = _said(verdict)
    loads = [a for a in verdict.alternatives if a.separated_by == LOAD]
    others = [
        a
        for a in verdict.alternatives
        if a.separated_by != LOAD and frozenset(map(_key, a.set)) not in known
    ]
    sets = [[phrase(p, verdict.dof) for p in a.set] for a in others[:_SHOWN]]
    lines = [f"As likely: {listing(words) or 'nothing'}." for words in sets]
    if len(others) > _SHOWN:
        more = len(others) - _SHOWN
        words = f"{count(more)} more {'set' if more == 1 else 'sets'}"
        lines.append(f"{sentence_case(words)}: 'alternatives' in the JSON.")
    if any(a.separated_by == MOTION for a in others):
        lines.append("Another motion would tell them apart.")
    elif others:
        lines.append("No motion tells them apart.")
    return lines + _mixed(loads, verdict)


def _said(verdict: Verdict) -> set[frozenset[Key]]:
    """Sets that differ from the named one by an equivalent alone."""
    named = _named(verdict)
    return {
        (named - {(finding.name, finding.joints)}) | {_key(other)}
        for finding in verdict.effects
        for other in finding.equivalent
    }


def _named(verdict: Verdict) -> frozenset[Key]:
    """What is named, one joint each where a finding is on several."""
    out = set()
    for finding in verdict.effects:
        several = [(j,) for j in finding.joints]
        lists = any(isinstance(p.value, tuple) for p in finding.parameters.values())
        places = several if lists else [finding.joints]
        out |= {(finding.name, joints) for joints in places}
    return frozenset(out)


def _mixed(loads: list[Alternative], verdict: Verdict) -> list[str]:
    """One sentence on bodies that move alike."""
    named = _named(verdict)
    extra = [place for a in loads for place in a.set if _key(place) not in named]
    if not extra:
        return []
    whole = " or ".join(phrase(place, verdict.dof) for place in extra)
    return [
        f"A part of the load may as well be {whole}: motion cannot tell them apart. "
        "Weigh the load, or log the arm without it."
    ]


def _key(place: Place) -> Key:
    return place.name, place.joints


MOST_VALUES = 12
_HUGE = 10.0  # times: of a value that was next to nothing a share says nothing
_LONGEST = 2  # parts of a sum that are printed; the JSON has all of them


def off(verdict: Verdict) -> list[Change]:
    """Return the values that are off and that no finding speaks of, worst first."""
    told = [c for c in verdict.changes if c.beyond and not c.explained]
    return sorted(told, key=lambda c: (not _of_drive(c, verdict), -abs(_share(c))))


def off_words(verdict: Verdict) -> str:
    """Return in one sentence which given values are off; empty where none is."""
    every = off(verdict)
    drives = [c for c in every if _of_drive(c, verdict)]
    sums = len(every) - len(drives)
    if not every:
        return ""
    few = len(drives) - _SHOWN <= 1
    shown = drives if few else drives[:_SHOWN]
    parts = [f"{_what(c, verdict)} ({_from_to(c)})" for c in shown]
    if not few:
        parts.append(f"{count(len(drives) - _SHOWN)} more")
    if sums:
        what = "sum" if sums == 1 else "sums"
        parts.append(f"{count(sums)} {what} of masses and inertias")
    verb = "is" if len(every) == 1 else "are"
    start = "Besides, " if verdict.effects else "But "
    many = count(len(every))
    return f"{start}{many} of its values {verb} off: {listing(parts)}."


def value_rows(changes: Sequence[Change], verdict: Verdict) -> list[tuple[str, ...]]:
    """Return rows of values: what it is, as given, as the logs have it, how far off."""
    return [
        (
            _what(change, verdict),
            f"{number(change.nominal)} {unit_text(change.unit)}".strip(),
            measured(change.identified, change.std, change.unit),
            f"{100 * _share(change):+.0f} %" if abs(_share(change)) < _HUGE else "",
        )
        for change in changes
    ]


def _what(change: Change, verdict: Verdict) -> str:
    if not _of_drive(change, verdict):
        parts = change.parameter.split(" + ")
        more = " + ..." if len(parts) > _LONGEST else ""
        return " + ".join(parts[:_LONGEST]) + more
    words = change.name.replace("_", " ")
    if change.parameter not in words:
        words = f"{words} {change.parameter}"
    where = joint_words(change.joints, verdict.dof)
    return f"{words} of {where}" if where else words


def _from_to(change: Change) -> str:
    unit = unit_text(change.unit)
    return f"{number(change.nominal)} → {number(change.identified)} {unit}".strip()


def _share(change: Change) -> float:
    """By how much a value is off, as a share of what was given."""
    if not known(change.identified) or not known(change.nominal):
        return 0.0
    gap = change.identified - change.nominal
    return gap / abs(change.nominal) if change.nominal else float("inf")


def _of_drive(change: Change, verdict: Verdict) -> bool:
    """Whether a value belongs to a declared effect, not to the body."""
    return change.name in verdict.declared


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
    rivals = [Place(p["name"], tuple(p["joints"])) for p in plan["rivals"]]
    apart = from_one_another(rivals)
    if plan["family"] is None:
        return [_promise(plan, apart)]
    periods = plan["parameters"].get("periods")
    times = f" in {many(periods, 'period')}" if periods else ""
    family = _FAMILIES.get(plan["family"], f"a motion of kind {plan['family']}")
    out = [f"{family} of {number(plan['seconds'])} s{times} tells {apart}"]
    if known(plan["chance"]):
        out.append(f"the question is {_sure(plan)}")
    if plan["program"]:
        out.append(f"program for the controller: {plan['program']}")
    else:
        out.append("modelgap next finds a better one, and writes it for a controller")
    return out


def _promise(plan: Mapping, apart: str) -> str:
    """What a free motion would tell, where none was designed yet."""
    sure = f", {_sure(plan)}," if known(plan["chance"]) else ""
    return (
        f"{number(plan['seconds'])} s of another motion may tell {apart}{sure} where "
        "nothing is in its way: modelgap next designs it for this arm"
    )


def _sure(plan: Mapping) -> str:
    return sure_words(plan["seconds"], plan.get("sure_after"), plan["chance"])


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
        f"{in_words(a)} and {in_words(b)} are one torque on every motion, at the size "
        "that was found: no experiment tells them apart"
        for a, b in pairs
    ]


def case_words(pairs: Sequence[tuple[Place, Place]]) -> list[str]:
    """Return which rivals are a case of another, a sentence each."""
    return [
        f"{in_words(a)} is a case of {in_words(b)}: a motion can rule out the first "
        "and never the second"
        for a, b in pairs
    ]
