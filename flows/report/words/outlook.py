"""Open questions of a verdict: unexplained torque, detectable sizes, next motion."""

from collections.abc import Sequence

from flows.report.words.phrases import (
    At,
    count_noun,
    joint_words,
    listing,
    number_word,
    phrase,
    place_key,
    sentence_case,
)
from residual.errors import joints_listed
from residual.planning.promise import NOTHING, TOGETHER, sure_words
from residual.quantity import MISSING, fraction, is_number, measured, number, unit_text
from residual.verdict.result import (
    LOAD,
    MOTION,
    Change,
    Dependence,
    Place,
    Verdict,
)

NEVER = "n.d."  # not detectable here: it would take more than an arm can have
_WHOLE_ARM = 10**6  # column of what does not sit on one joint: after every joint


def detectable_rows(verdict: Verdict) -> tuple[list[str], list[list[str]]]:
    """Return (heading, rows): the smallest detectable size of each effect, per joint.

    Effects on pairs of joints or on the whole arm get rows and a column of their own.
    """
    sizes: dict[str, dict[int, str]] = {}
    for item in verdict.minimum_detectable:
        local, unit = len(item.joints) == 1, unit_text(item.unit)
        name = " ".join([*item.name.split("_"), *map(str, item.joints[local:])])
        row = sizes.setdefault(f"{name} [{unit}]" if unit else name, {})
        size = "" if item.value is None else f"{item.value:.2g}"
        size = (
            number(item.value) if is_number(item.value) and item.value >= 100 else size
        )
        row[item.joints[0] if local else _WHOLE_ARM] = size or NEVER
    columns = sorted({column for row in sizes.values() for column in row})
    heads = ["arm" if c == _WHOLE_ARM else f"J{c}" for c in columns]
    rows = [
        [name, *(row.get(c, MISSING) for c in columns)] for name, row in sizes.items()
    ]
    return ["Effect", *heads], rows


def unexplained_words(verdict: Verdict) -> list[str]:
    """Return the unexplained torque in sentences."""
    unexplained = verdict.unexplained
    words = []
    if is_number(unexplained.fraction):
        noise = f"; noise alone is {fraction(unexplained.noise_floor)}"
        source = (
            f" (estimated from {unexplained.noise_model})"
            if unexplained.noise_model
            else ""
        )
        noise = noise + source if is_number(unexplained.noise_floor) else ""
        words.append(
            f"Unexplained: {fraction(unexplained.fraction)} of the torque{noise}."
        )
    if unexplained.joints:
        joints = joint_words(unexplained.joints, verdict.dof)
        kind = f" It is {unexplained.kind}." if unexplained.kind else ""
        words.append(f"The residual on {joints} is larger than noise.{kind}")
    by_joint: dict[int, list[str]] = {}
    for entry in unexplained.depends_on:
        by_joint.setdefault(entry.joint, []).append(_dependence(entry))
    words += [
        f"Of the residual on joint {joint}, {listing(parts)}."
        for joint, parts in by_joint.items()
    ]
    unclear = joint_words(j for j in unexplained.joints if j not in by_joint)
    if unclear:
        words.append(f"The residual on {unclear} depends on no known variable.")
    return words


def _dependence(entry: Dependence) -> str:
    share = fraction(entry.share)
    if entry.on == "frequency":
        return f"{share} oscillates at {number(entry.frequency)} Hz"
    by_sign = ", by direction of motion" if entry.form == "by direction" else ""
    if entry.on == "t":
        return f"{share} drifts with time{by_sign}"
    sign = " - " if entry.form == "difference" else " + "
    variable = sign.join(f"{entry.on}{joint}" for joint in entry.of)
    return f"{share} follows {variable}{by_sign}"


_SHOWN = 3


def other_sets(verdict: Verdict) -> list[str]:
    """Return sentences on other sets of effects that explain the logs as well.

    Sets in which one finding gives way to its equivalent stand with that finding.
    """
    named = set()  # one joint each where a finding is on several
    for finding in verdict.effects:
        lists = any(isinstance(p.value, tuple) for p in finding.parameters.values())
        joints = [(j,) for j in finding.joints] if lists else [finding.joints]
        named |= {(finding.name, each) for each in joints}
    shown_with_finding = {
        frozenset(named - {(finding.name, finding.joints)} | {place_key(other)})
        for finding in verdict.effects
        for other in finding.equivalent
    }
    loads = [a for a in verdict.alternatives if a.separated_by == LOAD]
    sets = [
        a
        for a in verdict.alternatives
        if a.separated_by != LOAD
        and frozenset(map(place_key, a.set)) not in shown_with_finding
    ]
    lines = []
    for each in sets[:_SHOWN]:
        effects = listing([phrase(p, verdict.dof) for p in each.set])
        lines.append(f"Equally well supported: {effects or 'no effect at all'}.")
    if len(sets) > _SHOWN:
        more = count_noun(len(sets) - _SHOWN, "more set")
        lines.append(f"And {more}: see 'alternatives' in the JSON.")
    if sets:
        motion = any(a.separated_by == MOTION for a in sets)
        lines.append(f"{'Another' if motion else 'No'} motion would separate them.")
    bodies = [p for a in loads for p in a.set if place_key(p) not in named]
    if bodies:
        words = " or ".join(phrase(body, verdict.dof) for body in bodies)
        lines.append(
            f"Part of the load may instead be {words}: no motion separates them. Weigh "
            "the load, or log the arm without it."
        )
    return lines


MOST_VALUES = 12
_HUGE = 10.0  # times: of a value that was next to nothing a share says nothing
_LONGEST = 2  # parts of a sum that are printed; the JSON has all of them


def off(verdict: Verdict) -> list[Change]:
    """Return the nominal values that are off and in no finding, worst first."""
    changes = [c for c in verdict.changes if c.beyond and not c.explained]
    return sorted(
        changes, key=lambda c: (c.name not in verdict.declared, -abs(_share(c)))
    )


def off_words(verdict: Verdict) -> str:
    """Return in one sentence which nominal values are off; empty where none is."""
    changes = off(verdict)
    drives = [c for c in changes if c.name in verdict.declared]
    sums = len(changes) - len(drives)
    if not changes:
        return ""
    shown = drives if len(drives) <= _SHOWN + 1 else drives[:_SHOWN]
    parts = []
    for c in shown:
        values = f"{number(c.nominal)} → {number(c.identified)} {unit_text(c.unit)}"
        parts.append(f"{_value_name(c, verdict)} ({values.strip()})")
    if len(drives) > len(shown):
        parts.append(f"{number_word(len(drives) - len(shown))} more")
    if sums:
        noun = "combination" if sums == 1 else "combinations"
        parts.append(f"{number_word(sums)} {noun} of masses and inertias")
    verb = "value disagrees" if len(changes) == 1 else "values disagree"
    number_of = sentence_case(number_word(len(changes)))
    return f"{number_of} nominal {verb} with the logs: {listing(parts)}."


def value_rows(changes: Sequence[Change], verdict: Verdict) -> list[tuple[str, ...]]:
    """Return rows of values: name, nominal, identified, difference."""
    return [
        (
            _value_name(change, verdict),
            f"{number(change.nominal)} {unit_text(change.unit)}".strip(),
            measured(change.identified, change.std, change.unit),
            f"{100 * _share(change):+.0f} %" if abs(_share(change)) < _HUGE else "",
        )
        for change in changes
    ]


def _value_name(change: Change, verdict: Verdict) -> str:
    if change.name not in verdict.declared:
        parts = change.parameter.split(" + ")
        more = " + ..." if len(parts) > _LONGEST else ""
        return " + ".join(parts[:_LONGEST]) + more
    words = change.name.replace("_", " ")
    if change.parameter not in words:
        words = f"{words} {change.parameter}"
    joints = joint_words(change.joints, verdict.dof)
    return f"{words} of {joints}" if joints else words


def _share(change: Change) -> float:
    """By how much a value is off, as a share of the nominal."""
    if not is_number(change.identified) or not is_number(change.nominal):
        return 0.0
    gap = change.identified - change.nominal
    return gap / abs(change.nominal) if change.nominal else float("inf")


def next_words(verdict: Verdict) -> list[str]:
    """Return the proposed experiment, a sentence each; none where nothing is open."""
    plan = verdict.next_experiment
    if not plan:
        alike = any(finding.equivalent for finding in verdict.effects)
        text = "modelgap next looks for a motion that separates the alternatives."
        return [text] if alike else []
    rivals = [Place(p["name"], tuple(p["joints"])) for p in plan["rivals"]]
    apart, seconds = from_one_another(rivals), number(plan["seconds"])
    chance = plan["chance"]
    sure = sure_words(plan["seconds"], plan.get("sure_after"), chance)
    if plan["family"] is None:
        chances = f" ({sure})" if is_number(chance) else ""
        return [
            f"{seconds} s of another motion may separate {apart}{chances}, if no "
            "obstacle is in the way: modelgap next designs it for this arm."
        ]
    periods = plan["parameters"].get("periods")
    times = f" in {count_noun(periods, 'period')}" if periods else ""
    family = plan["family"].replace("_", "-")
    program = plan["program"]
    return [
        f"{seconds} s of {family} motion{times} separates {apart}.",
        *([f"The question is {sure}."] if is_number(chance) else []),
        f"Program for the controller: {program}"
        if program
        else "modelgap next looks for a better one and writes it for a controller.",
    ]


def from_one_another(rivals: Sequence[Place]) -> str:
    """Return rivals in words: 'a spring on joint 2 from an offset on joint 2'."""
    words = [in_words(place) for place in rivals]
    if len(words) == 2:
        return f"{words[0]} from {words[1]}"
    return f"{listing(words)} from one another"


def in_words(place: At) -> str:
    """Return a rival in words."""
    if place == NOTHING:
        return "no effect at all"
    if TOGETHER not in place.name:
        return phrase(place)
    names = listing(place.name.split(TOGETHER))
    return f"{names} together on {joints_listed(place.joints)}"
