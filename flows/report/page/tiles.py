"""The figures at the head of the report: size, meaning and gain, then how sure."""

from flows.report.page.base import Tile
from flows.report.words import verdict as words
from flows.report.words.means import missing_torque, size_of, sure
from flows.report.words.phrases import joint_words, sentence_case
from flows.report.words.rows import FindingRow
from residual import quantity
from residual.diagnosis.result import Diagnosis
from residual.quantity import known


def tiles_of(found: Diagnosis, named: list[FindingRow]) -> list[Tile]:
    """Return up to five figures that say what is missing, and what naming it gains."""
    return [
        *(_one_size(found, named) if len(named) == 1 else _count(named)),
        *_torque(found, named),
        *_error(found, named),
        *_sure(named),
        *_left(found),
    ]


def _one_size(found: Diagnosis, named: list[FindingRow]) -> list[Tile]:
    name, value = size_of(found.effects[0])
    return [Tile(sentence_case(name), value, f"of {named[0].title}")] if name else []


def _count(named: list[FindingRow]) -> list[Tile]:
    if not named:
        return []
    confirmed = sum(one.verdict == "confirmed" for one in named)
    note = f"{confirmed} of them confirmed on unseen motion"
    return [Tile("Effects found", str(len(named)), note)]


def _torque(found: Diagnosis, named: list[FindingRow]) -> list[Tile]:
    """What the robot's controller does not know: the most that a model lacks."""
    lacking = [(m, row) for row in named for m in missing_torque(found, row)]
    if not lacking:
        return []
    most, row = max(lacking, key=lambda pair: pair[0].share or 0.0)
    note = joint_words([most.joint])
    if most.share:
        note += f": {quantity.fraction(most.share)} of the largest torque there"
    if len(named) > 1:
        note += f", from {row.noun}"
    value = f"up to {quantity.number(most.peak)} N m"
    return [Tile("Torque that the model lacks", value, note)]


def _error(found: Diagnosis, named: list[FindingRow]) -> list[Tile]:
    label = "Error on unseen motion"
    change = words.change(found.verdict) if named else None
    if change:
        fall = f"{change.before:.1f} → {quantity.percent(change.after)}"
        where = change.where.removesuffix(",")
        return [Tile(label, fall, f"of the torque {where}, before → after")]
    if named:
        return []
    level, where = words.level(found.errors)
    note = f"of the torque {where}, refitted"
    return [Tile(label, quantity.percent(level), note)]


def _sure(named: list[FindingRow]) -> list[Tile]:
    if not named:
        return []
    if len(named) == 1:
        one = named[0]
        other = f", or {' or '.join(one.alternatives)}" if one.alternatives else ""
        note = f"that it is {one.noun}{other}; {one.held_out}"
        return [Tile("How sure", sure(one.probability), note)]
    likely = [one.probability for one in named if known(one.probability)]
    weakest = sure(min(likely, default=None))
    return [Tile("How sure", weakest, "of the least certain name, against all others")]


def _left(found: Diagnosis) -> list[Tile]:
    left = found.unexplained
    if not known(left.fraction):
        return []
    note = "of the torque"
    if known(left.noise_floor):
        note += f"; noise alone is {quantity.fraction(left.noise_floor)}"
    return [Tile("Still unexplained", quantity.fraction(left.fraction), note)]
