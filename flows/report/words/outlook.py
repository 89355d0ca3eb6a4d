"""What the findings leave open: the rest, what was too small to see, what is next."""

from collections.abc import Mapping
from typing import Any

from flows.report.words.phrases import joint_words, listing, noun, phrase, sentence_case
from flows.report.words.quantity import (
    MISSING,
    as_list,
    fraction,
    known,
    number,
    records,
    texts,
    unit_text,
)
from flows.report.words.verdict import joint_count
from residual.diagnosis.result import Outcome

_ELSEWHERE = 10**6  # column of what does not sit on one joint: after every joint


def detectable_rows(
    outcome: Outcome, short: bool = False
) -> tuple[list[str], list[list[str]]]:
    """Return (heading, rows): smallest size that would have been found, per joint.

    Effects on pairs of joints or on the whole arm get rows and a column of their own.

    Args:
        outcome: The diagnosis.
        short: Call effects by their names and joints J1, for narrow columns.
    """
    sizes: dict[tuple[str, str], dict[int, str]] = {}
    for item in records(outcome.verdict.get("minimum_detectable")):
        joints = as_list(item.get("joints"))
        local = len(joints) == 1
        if short:
            name = " ".join(texts([item.get("name"), *joints[local:]]))
        else:
            name = noun(item.get("name")) if local else phrase(item)
        key = (name, unit_text(item.get("unit")))
        column = joints[0] if local else _ELSEWHERE
        sizes.setdefault(key, {})[column] = number(item.get("value"))
    columns = sorted({column for found in sizes.values() for column in found})
    joint, other = ("J", "else") if short else ("Joint ", "Pair or arm")
    heads = [other if c == _ELSEWHERE else f"{joint}{c}" for c in columns]
    rows = [
        [name, unit, *(found.get(c, MISSING) for c in columns)]
        for (name, unit), found in sizes.items()
    ]
    return ["Effect", "Unit", *heads], rows


def confusable_words(verdict: Mapping) -> str | None:
    """Return what these logs could not tell apart, in a sentence; None if nothing."""
    pairs: dict[tuple[str, str], set[int]] = {}
    for item in records(verdict.get("minimum_detectable")):
        joints = as_list(item.get("joints"))
        for other in records(item.get("confusable")):
            if as_list(other.get("joints")) == joints:
                one, two = sorted(noun(x["name"]) for x in (item, other))
                pairs.setdefault((one, two), set()).update(joints)
            else:
                pairs.setdefault((phrase(item), phrase(other)), set())
    if not pairs:
        return None
    told = [
        f"{one} and {two}{f' on {joint_words(sorted(on))}' if on else ''}"
        for (one, two), on in pairs.items()
    ]
    return (
        "Even three times as large, these logs would not tell apart: "
        f"{'; '.join(told)}."
    )


def unexplained_words(verdict: Mapping) -> list[str]:
    """Return what is left after the findings, in sentences."""
    left = verdict.get("unexplained") or {}
    words = []
    if known(left.get("fraction")):
        sentence = f"{fraction(left['fraction'])} of the torque stays unexplained"
        floors = [f for f in as_list(left.get("noise_floor")) if known(f)]
        if floors:
            ends = sorted({fraction(min(floors)), fraction(max(floors))})
            source = left.get("noise_model")
            sentence += f"; noise alone is {' to '.join(ends)}"
            sentence += f" (from {source})" if source else ""
        words.append(f"{sentence}.")
    if left.get("joints"):
        who = sentence_case(joint_words(left["joints"], joint_count(verdict)))
        words.append(f"{who}: too much is left to call the model complete.")
    if left.get("kind"):
        words.append(f"What is left is {left['kind']}.")
    words += _dependences(left)
    return words


def _dependences(left: Mapping) -> list[str]:
    """Return what the rest of each joint depends on, one sentence per joint."""
    entries = records(left.get("depends_on"))
    known_joints = list(dict.fromkeys(entry["joint"] for entry in entries))
    words = []
    for joint in known_joints:
        own = [_dependence(e) for e in entries if e["joint"] == joint]
        words.append(f"Of what joint {joint} keeps, {listing(own)}.")
    lost = [j for j in as_list(left.get("joints")) if j not in known_joints]
    if lost:
        who = joint_words(lost)
        words.append(f"What the rest on {who} depends on is not known.")
    return words


def _dependence(entry: Mapping) -> str:
    share = fraction(entry["share"])
    if entry["on"] == "frequency":
        return f"{share} swings at {number(entry['frequency'])} Hz"
    turned = " with the sign of the motion" if entry["form"] == "by direction" else ""
    if entry["on"] == "t":
        return f"{share} drifts with time{turned}"
    sign = " - " if entry["form"] == "difference" else " + "
    variable = sign.join(f"{entry['on']}{joint}" for joint in entry["of"])
    return f"{share} follows {variable}{turned}"


def next_words(plan: Any) -> list[str]:
    """Return the proposed next experiment as lines, whatever form it has."""
    if plan is None:
        return []
    if isinstance(plan, Mapping):
        return [
            f"{str(key).replace('_', ' ')}: {_flat(value)}"
            for key, value in plan.items()
            if value is not None
        ]
    return [_flat(item) for item in as_list(plan)]


def _flat(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_flat(item)}" for key, item in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(map(_flat, value))
    return number(value) if isinstance(value, float) else str(value)
