"""The rows of every table, once, for the terminal and the page alike."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from flows.report.words.phrases import alternatives, noun, phrase, place, sentence_case
from flows.report.words.quantity import (
    MISSING,
    as_list,
    dig,
    fraction,
    known,
    measured,
    number,
)
from flows.report.words.verdict import held_out_words, joint_count, ordered
from residual.diagnosis.result import Outcome

STAGES = ("nominal", "identified", "augmented", "plsr")
METRICS = {"filtered": "filtered", "moving": "moving", "held_out": "as logged"}


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of a finding as text; joint is None where it has only one."""

    name: str
    joint: int | None
    text: str


@dataclass(frozen=True, slots=True)
class Finding:
    """One finding, ready to be printed."""

    name: str
    order: str
    title: str
    noun: str
    place: str
    joints: tuple[int, ...]
    sentence: str
    parameters: tuple[Parameter, ...]
    probability: Any
    nats: str
    by: str
    verdict: str
    held_out: str
    gain: str
    p_value: str
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


def findings(outcome: Outcome) -> list[Finding]:
    """Return the findings, first found first."""
    verdict = outcome.verdict
    dof = dof_of(outcome)
    listed = as_list(verdict.get("effects"))
    said = dict(zip(map(id, listed), outcome.sentences, strict=False))
    return [
        _finding(effect, position, said.get(id(effect), ""), dof)
        for position, effect in enumerate(ordered(verdict), start=1)
    ]


def error_rows(outcome: Outcome) -> list[ErrorRow]:
    """Return one row per joint and one for all joints together."""
    verdict, dof = outcome.verdict, dof_of(outcome) or 0
    flagged = as_list(dig(verdict, "unexplained", "joints"))
    shares = joint_shares(verdict, "fraction")
    rows = []
    for joint in range(1, dof + 1):
        values = {metric: _at(verdict, metric, joint) for metric in METRICS}
        share = shares[joint - 1] if joint <= len(shares) else None
        rows.append(ErrorRow(str(joint), joint, values, share, joint in flagged))
    overall = {
        "filtered": dig(verdict, "error", "overall_filtered") or {},
        "moving": {},
        "held_out": dig(verdict, "error", "overall") or {},
    }
    share = dig(verdict, "unexplained", "fraction")
    share = 100 * share if known(share) else None
    return [*rows, ErrorRow("all", None, overall, share, False)]


def joint_shares(verdict: Mapping, key: str) -> list[float | None]:
    """Return one quantity of "unexplained" per joint [%]; None where not known.

    An entry per joint is a record of several quantities, or the fraction alone.
    """
    found = []
    for entry in as_list(dig(verdict, "unexplained", "per_joint")):
        value = entry if key == "fraction" and known(entry) else dig(entry, key)
        found.append(100 * value if known(value) else None)
    return found


def has(rows: Sequence[ErrorRow], metric: str, stage: str) -> bool:
    """Return whether any joint has this error."""
    return any(known(row.values[metric].get(stage)) for row in rows)


def dof_of(outcome: Outcome) -> int | None:
    """Return the number of joints, from the errors or else from the held-out logs."""
    found = joint_count(outcome.verdict)
    if found is None and outcome.proofs:
        found = outcome.proofs[0].tau.shape[1]
    return found


def parameter_lines(finding: Finding, width: int) -> list[str]:
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
    return lines


def _finding(effect: Mapping, position: int, sentence: str, dof: Any) -> Finding:
    evidence = effect.get("evidence") or {}
    order = effect.get("order")
    return Finding(
        name=effect.get("name") or "",
        order=str(order if order is not None else position),
        title=phrase(effect, dof),
        noun=noun(effect.get("name")),
        place=place(effect, dof),
        joints=tuple(effect.get("joints") or ()),
        sentence=_full_stop(sentence),
        parameters=tuple(_parameters(effect)),
        probability=effect.get("probability"),
        nats=number(evidence.get("nats")),
        by=evidence.get("by") or "",
        verdict=evidence.get("held_out") or "not tried",
        held_out=held_out_words(evidence.get("held_out")),
        gain=fraction(evidence.get("held_out_gain")),
        p_value=number(evidence.get("p_value")),
        alternatives=tuple(alternatives(effect, dof)),
    )


def _full_stop(sentence: Any) -> str:
    text = sentence_case(str(sentence or "").strip())
    return text if not text or text[-1] in ".!?" else f"{text}."


def _parameters(effect: Mapping) -> list[Parameter]:
    joints = list(effect.get("joints") or [])
    rows = []
    for key, entry in (effect.get("parameters") or {}).items():
        entry = entry if isinstance(entry, Mapping) else {"value": entry}
        value, std, unit = (entry.get(k) for k in ("value", "std", "unit"))
        name = str(key).replace("_", " ")
        if not isinstance(value, list | tuple):
            rows.append(Parameter(name, None, measured(value, std, unit)))
            continue
        stds = std if isinstance(std, list | tuple) else [std] * len(value)
        for i, item in enumerate(value):
            joint = joints[i] if i < len(joints) else None
            spread = stds[i] if i < len(stds) else None
            rows.append(Parameter(name, joint, measured(item, spread, unit)))
    return rows


def _at(verdict: Mapping, metric: str, joint: int) -> dict[str, float | None]:
    """Return the error of one joint per stage, where it is known."""
    stages = dig(verdict, "error", metric) or {}
    return {
        stage: as_list(values)[joint - 1]
        for stage, values in stages.items()
        if len(as_list(values)) >= joint
    }
