"""Sizes of a finding in words that people have: a change, an amplitude, a frame."""

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from math import floor, log10

import numpy as np

from flows.report.words.phrases import effect_named, listing
from flows.report.words.verdict import is_wrong_value
from residual.diagnosis.result import Change, Finding, Frames, Number, Verdict
from residual.quantity import MISSING, known, measured, number, unit_text

OPEN = "not determined"
DIGITS = 3  # of the larger of two values, before and after
STEP = 1e-3  # of a deviation, for derivatives


@dataclass(frozen=True, slots=True)
class Size:
    """One size of a finding.

    Attributes:
        name: What it is of.
        joint: Joint from 1; None where there is only one.
        value, std, unit: The size; the value None where it is not determined.
        change: The value of the model before; None where it is no change of one.
        signed: Whether it says by how much something is more or less.
    """

    name: str
    joint: int | None
    value: Number
    std: Number
    unit: str
    change: Number = None
    signed: bool = False

    @property
    def text(self) -> str:
        """The size with its deviation: '+4.99 ± 0.12 N m (8.0 → 13.0)'."""
        if self.value is None:
            return OPEN
        said = measured(self.value, self.std, self.unit)
        if self.signed and self.value > 0 and not said.startswith("("):
            said = f"+{said}"
        return said if self.change is None else f"{said} ({self.from_to})"

    @property
    def from_to(self) -> str:
        """The value before and after: '8.0 → 13.0'."""
        if self.change is None or self.value is None:
            return MISSING
        ends = self.change, self.change + self.value
        largest = max(map(abs, ends))
        places = max(DIGITS - 1 - floor(log10(largest)), 0) if largest else 0
        return " → ".join(f"{end:.{places}f}" for end in ends)


def sizes(effect: Finding, verdict: Verdict) -> list[Size]:
    """Return the sizes of a finding: as its effect tells them, else its parameters."""
    told = effect_named(effect.name).told
    clear = all(p.determined for p in effect.parameters.values())
    parts = list(_told(effect) if told and clear else _plain(effect))
    if not is_wrong_value(effect, verdict):
        return parts
    keys = {key.replace("_", " "): key for key in effect.parameters}
    return [_changed(one, keys.get(one.name), effect, verdict) for one in parts]


def size_of(effect: Finding, verdict: Verdict) -> tuple[str, str]:
    """Return (name, value) of the first size that the logs determine.

    Of several joints the smallest and the largest value; a wave with its place.
    """
    every = [one for one in sizes(effect, verdict) if one.value is not None]
    if not every:
        return "", MISSING
    name = every[0].name
    same = [one for one in every if one.name == name]
    if len(same) == 1:
        others = [o for o in every[1:] if effect_named(effect.name).told]
        return name, ", ".join([same[0].text, *(f"{o.name} {o.text}" for o in others)])
    low, high = (f(one.value for one in same if known(one.value)) for f in (min, max))
    sign = "+" if same[0].signed and low > 0 else ""
    span = f"{sign}{number(low)} to {sign}{number(high)} {unit_text(same[0].unit)}"
    return name, span.strip()


def frame_words(effect: Finding, frames: Frames | None) -> str:
    """Return what the vectors of a finding are in; empty where it has none."""
    flange = "the flange" if frames is None or not frames.flange else frames.flange
    return effect_named(effect.name).frame.format(flange=flange)


def named_joints(joints: Iterable[int], frames: Frames | None) -> str:
    """Return what the URDF calls joints, where that says more than their numbers."""
    if frames is None:
        return ""
    every = [(j, frames.joints[j - 1]) for j in joints if j <= len(frames.joints)]
    return listing([name for j, name in every if tells(name, j)])


def tells(name: str, joint: int) -> bool:
    """Return whether a joint's name says more than its number: not so "joint_2"."""
    plain = rf"(?:.*[_-])?(?:joint|axis|j|a|q)?[_-]?0*{joint}"
    return re.fullmatch(plain, name, re.IGNORECASE) is None


def _plain(effect: Finding) -> Iterator[Size]:
    for key, parameter in effect.parameters.items():
        name, unit = key.replace("_", " "), parameter.unit
        for joint, (value, std) in zip(_joints(effect), parameter.pairs, strict=False):
            known_value = value if parameter.determined else None
            yield Size(name, joint, known_value, std, unit)


def _joints(effect: Finding) -> Sequence[int | None]:
    many = any(isinstance(p.value, tuple) for p in effect.parameters.values())
    return effect.joints if many else (None,)


def _told(effect: Finding) -> Iterator[Size]:
    """As the effect tells its values, deviations taken along as independent."""
    told = effect_named(effect.name).told
    pairs = [p.pairs for p in effect.parameters.values()]
    if told is None or any(not known(v) for own in pairs for v, _ in own):
        yield from _plain(effect)
        return
    for joint, own in zip(_joints(effect), zip(*pairs, strict=True), strict=False):
        values = np.array([v for v, _ in own], dtype=float)
        stds = np.array([s if known(s) else 0.0 for _, s in own])
        at, spread = told(values), dict.fromkeys(told(values), 0.0)
        for i, std in enumerate(stds):
            near = told(values + STEP * std * np.eye(len(values))[i])
            for name in at:
                spread[name] += ((near[name][0] - at[name][0]) / STEP) ** 2
        for name, (value, unit) in at.items():
            yield Size(name, joint, value, float(np.sqrt(spread[name])), unit)


def _changed(one: Size, key: str | None, effect: Finding, verdict: Verdict) -> Size:
    """A size as a change, from the value that the model was given where it was."""
    before = None
    on = effect.joints if one.joint is None else (one.joint,)
    for change in verdict.changes if key else ():
        if _is_of(change, effect.name, on) and change.parameter == key:
            before = change.nominal if known(change.nominal) else None
    return Size(one.name, one.joint, one.value, one.std, one.unit, before, True)


def _is_of(change: Change, name: str, joints: Sequence[int]) -> bool:
    return change.name == name and tuple(change.joints) == tuple(joints)
