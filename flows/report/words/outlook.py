"""What the findings leave open: the rest, what was too small to see, what is next."""

from flows.report.words.phrases import (
    joint_words,
    kind,
    listing,
    noun,
    phrase,
    sentence_case,
)
from residual.diagnosis.leftover.remainder import Dependence, Number, Unexplained
from residual.diagnosis.result import Verdict
from residual.quantity import MISSING, fraction, known, number, unit_text

NEVER = "n.d."  # not detectable here: it would take more than an arm can have
_ELSEWHERE = 10**6  # column of what does not sit on one joint: after every joint


def detectable_rows(
    verdict: Verdict, short: bool = False
) -> tuple[list[str], list[list[str]]]:
    """Return (heading, rows): smallest size that would have been found, per joint.

    Effects on pairs of joints or on the whole arm get rows and a column of their own.

    Args:
        short: Call effects by their names and joints J1, for narrow columns.
    """
    sizes: dict[tuple[str, str], dict[int, str]] = {}
    for item in verdict.minimum_detectable:
        joints = item.joints
        local = len(joints) == 1
        if short:
            name = " ".join([*item.name.split("_"), *map(str, joints[local:])])
        else:
            name = kind(item.name) if local else phrase(item)
        column = joints[0] if local else _ELSEWHERE
        row = sizes.setdefault((name, unit_text(item.unit)), {})
        row[column] = _size(item.value, short)
    columns = sorted({column for found in sizes.values() for column in found})
    joint, other = ("J", "else") if short else ("Joint ", "Pair or arm")
    heads = [other if c == _ELSEWHERE else f"{joint}{c}" for c in columns]
    rows = [
        [name, unit, *(found.get(c, MISSING) for c in columns)]
        for (name, unit), found in sizes.items()
    ]
    return ["Effect", "Unit", *heads], rows


def _size(value: Number, short: bool) -> str:
    if value is None:
        return NEVER
    return f"{value:.2g}" if short and value < 100 else number(value)


def confusable_words(verdict: Verdict) -> str | None:
    """Return how many effects these logs could not tell apart; None if none."""
    pairs = confusable_pairs(verdict)
    if not pairs:
        return None
    one = len(pairs) == 1
    return (
        f"Even at three times these sizes, {len(pairs)} pair{'' if one else 's'} of "
        f"effects would look alike in these logs."
    )


def confusable_pairs(verdict: Verdict) -> list[str]:
    """Return what these logs could not tell apart at three times these sizes."""
    pairs: dict[tuple[str, str], set[int]] = {}
    for item in verdict.minimum_detectable:
        for other in item.confusable:
            if other.joints == item.joints:
                one, two = sorted(noun(x.name) for x in (item, other))
                pairs.setdefault((one, two), set()).update(item.joints)
            else:
                pairs.setdefault((phrase(item), phrase(other)), set())
    return [
        f"{one} and {two}{f' on {joint_words(sorted(on))}' if on else ''}"
        for (one, two), on in pairs.items()
    ]


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
