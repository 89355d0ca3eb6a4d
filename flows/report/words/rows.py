"""The rows of every table of a diagnosis, and what a finding means for the robot."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from textwrap import wrap
from typing import NamedTuple

import numpy as np

from flows.report.words.phrases import alternatives, noun, phrase, place, sentence_case
from flows.report.words.sizes import frame_words, named_joints, sizes
from flows.report.words.verdict import held_out_words
from residual.diagnosis.result import (
    Diagnosis,
    Finding,
    Number,
    PerJoint,
    Splits,
    Verdict,
)
from residual.effects import registry
from residual.model.compare import Cloud
from residual.quantity import MISSING, fraction, known, number

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
            return f"p > {limit:g}"
    return f"p = {probability:.2f}" if probability >= 0.01 else "p < 0.01"


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
