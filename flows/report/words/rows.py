"""The rows of every table of a diagnosis, and what a finding means for the robot."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import floor, log10
from textwrap import wrap
from typing import NamedTuple

import numpy as np

from flows.report.words.phrases import (
    alternatives,
    effect_named,
    listing,
    noun,
    phrase,
    place,
    sentence_case,
)
from flows.report.words.verdict import held_out_words, is_wrong_value
from residual.diagnosis.result import (
    Change,
    Diagnosis,
    Finding,
    Frames,
    Number,
    PerJoint,
    Splits,
    Verdict,
)
from residual.effects import registry
from residual.model.compare import Cloud
from residual.quantity import MISSING, fraction, known, measured, number, unit_text

METRICS = {"moving": "moving", "filtered": "filtered", "held_out": "as logged"}


@dataclass(frozen=True, slots=True)
class ParameterRow:
    """One parameter of a finding as text; joint is None where it has only one."""

    name: str
    joint: int | None
    text: str


@dataclass(frozen=True, slots=True)
class FindingRow:
    """One finding, ready to be printed."""

    name: str
    order: str
    title: str
    noun: str
    place: str
    joints: tuple[int, ...]
    sentence: str
    parameters: tuple[ParameterRow, ...]
    frame: str
    probability: Number
    nats: str
    by: str
    verdict: str
    held_out: str
    gain: str
    p_value: str
    splits: str
    alternatives: tuple[str, ...]

    @property
    def table(self) -> tuple[list[str], list[list[str]]]:
        """Parameters as (heading, rows): a row per joint, or per parameter."""
        joints = dict.fromkeys(p.joint for p in self.parameters if p.joint is not None)
        if not joints:
            rows = [[p.name, p.text] for p in self.parameters]
            return ["Parameter", "Value"], rows
        names = list(dict.fromkeys(p.name for p in self.parameters))
        found = {(p.name, p.joint): p.text for p in self.parameters}
        rows = [
            [f"Joint {j}", *(found.get((name, j), MISSING) for name in names)]
            for j in joints
        ]
        return ["On", *map(sentence_case, names)], rows


@dataclass(frozen=True, slots=True)
class ErrorRow:
    """Held-out error of one joint, or of all, per metric and stage [%]."""

    label: str
    joint: int | None
    values: Mapping[str, Mapping[str, float | None]]
    unexplained: float | None
    flagged: bool


def findings(found: Diagnosis) -> list[FindingRow]:
    """Return the findings, most important first."""
    said = dict(enumerate(found.sentences))
    return [
        _finding(effect, said.get(i, ""), found.verdict)
        for i, effect in enumerate(found.effects)
    ]


def error_rows(found: Diagnosis) -> list[ErrorRow]:
    """Return one row per joint and one for all joints together."""
    left, error = found.unexplained, found.errors
    rows = []
    for joint, share in enumerate(left.per_joint, start=1):
        values = {metric: _at(getattr(error, metric), joint) for metric in METRICS}
        flagged = joint in left.joints
        rows.append(ErrorRow(str(joint), joint, values, _percent(share), flagged))
    overall = {
        "moving": error.overall_moving,
        "filtered": error.overall_filtered,
        "held_out": error.overall,
    }
    return [*rows, ErrorRow("all", None, overall, _percent(left.fraction), False)]


def _percent(share: Number) -> Number:
    return 100 * share if known(share) else None


def has(rows: Sequence[ErrorRow], metric: str, stage: str) -> bool:
    """Return whether any joint has this error."""
    return any(known(row.values[metric].get(stage)) for row in rows)


def parameter_lines(finding: FindingRow, width: int) -> list[str]:
    """Return the parameters as lines: a name, then its value or one per joint."""
    lines: list[str] = []
    for name in dict.fromkeys(p.name for p in finding.parameters):
        mine = [p for p in finding.parameters if p.name == name]
        single = f"{name} {mine[0].text}"
        if mine[0].joint is None and len(single) <= width:
            lines.append(single)
            continue
        lines.append(name)
        for one in mine:
            joint = "" if one.joint is None else f"J{one.joint} "
            lines.append(f"  {joint}{one.text}")
    return [*lines, *wrap(finding.frame, width)]


def _finding(effect: Finding, sentence: str, verdict: Verdict) -> FindingRow:
    evidence, dof, frames = effect.evidence, verdict.dof, verdict.frames
    called = named_joints(effect.joints, frames)
    return FindingRow(
        name=effect.name,
        order=str(effect.order),
        title=phrase(effect, dof) + (f" ({called})" if called else ""),
        noun=noun(effect.name),
        place=place(effect, dof),
        joints=effect.joints,
        sentence=_full_stop(sentence),
        parameters=tuple(_parameters(effect, verdict)),
        frame=frame_words(effect, frames),
        probability=effect.probability,
        nats=number(evidence.nats),
        by=evidence.by or "",
        verdict=evidence.held_out or "not tried",
        held_out=held_out_words(evidence.held_out),
        gain=fraction(evidence.held_out_gain),
        p_value=number(evidence.p_value),
        splits=_splits(evidence.splits),
        alternatives=tuple(alternatives(effect, dof)),
    )


def _splits(splits: Splits | None) -> str:
    """How often a name came back without a part of the data: '3 of 3'."""
    return f"{splits.found} of {splits.of}" if splits and splits.of else ""


def _full_stop(sentence: str) -> str:
    text = sentence_case(sentence.strip())
    return text if not text or text[-1] in ".!?" else f"{text}."


def _parameters(effect: Finding, verdict: Verdict) -> list[ParameterRow]:
    rows = [ParameterRow(o.name, o.joint, o.text) for o in sizes(effect, verdict)]
    for formula, parameter in effect.combinations.items():
        rows.append(ParameterRow(formula, None, str(parameter)))
    return rows


def _at(stages: PerJoint, joint: int) -> dict[str, Number]:
    """Return the error of one joint by model, where it is known."""
    return {k: v[joint - 1] for k, v in stages.items() if v is not None}


_CERTAIN = (0.999, 0.99)


class Missing(NamedTuple):
    """Torque of an effect on one joint.

    Attributes:
        joint: Joint from 1.
        peak: The most of it on the logs of the fit [N m].
        share: That, of the largest torque measured there on held-out motion; None
            where that is not known.
    """

    joint: int
    peak: float
    share: float | None


def missing_torque(found: Diagnosis, row: FindingRow) -> list[Missing]:
    """Return what the torque lacks without a finding, the largest share first."""
    effect = registry().get(row.name)
    mine = [c for c in found.clouds if c.name == row.name and len(c.x)]
    if effect is not None and effect.variable is not None and row.joints:
        mine = [c for c in mine if c.joint in row.joints] or mine
    out = []
    for cloud in mine:
        peak = float(np.abs(cloud.fitted).max())
        whole = _largest(found, cloud.joint)
        out.append(Missing(cloud.joint, peak, peak / whole if whole else None))
    return sorted(out, key=lambda one: -(one.share or 0.0))


def means(found: Diagnosis, row: FindingRow) -> str:
    """Return in one sentence what a model without it gets wrong; empty if unknown."""
    lacking = missing_torque(found, row)[:2]
    if not lacking:
        return ""
    parts = [
        f"by up to {number(one.peak)} N m on joint {one.joint}"
        + (f" ({fraction(one.share)} of the largest torque there)" if one.share else "")
        for one in lacking
    ]
    return f"Without it the predicted torque is off {' and '.join(parts)}."


def sure(probability: float | None) -> str:
    """Return a probability as people weigh it: never one, since no data give that."""
    if not known(probability):
        return MISSING
    for limit in _CERTAIN:
        if probability > limit:
            return f"probability > {limit:g}"
    if probability < 0.01:
        return "probability < 0.01"
    return f"probability = {probability:.2f}"


def explained_share(cloud: Cloud) -> float | None:
    """Return the part of a residual's mean square that an effect explains."""
    whole = float(np.mean(cloud.residual**2))
    if not whole:
        return None
    left = float(np.mean((cloud.residual - cloud.fitted) ** 2))
    return max(0.0, 1 - left / whole)


def _largest(found: Diagnosis, joint: int) -> float | None:
    sizes = [
        float(np.abs(p.tau[:, joint - 1]).max())
        for p in found.proofs
        if len(p.t) and joint <= p.tau.shape[1]
    ]
    return max(sizes, default=None)


# Sizes of a finding in words that people have: a change, an amplitude, a frame.

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
