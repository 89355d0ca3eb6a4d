"""The rows of every table of a diagnosis, and the sizes of a finding."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import floor, log10

import numpy as np

from flows.report import BoldText, ReportTable, build_text_table, html_tag
from flows.report.phrases import (
    capitalize_first,
    find_effect,
    format_effect_place,
    format_equivalent_phrases,
    join_with_and,
)
from flows.report.sentences import compute_change_share, is_wrong_value, name_value
from residual.quantity import (
    MISSING,
    format_fraction,
    format_number,
    format_percent_number,
    format_probability,
    format_uncertain_value,
    format_unit,
    is_number,
)
from residual.verdict.result import PLAIN, STAGES, Change, Diagnosis, Finding, Number, Verdict

_WIDEST = 11  # columns of joints and their sum that a terminal shows
_HUGE = 10.0  # times: of a value that was next to nothing a share says nothing
NEVER = "n.d."  # not detectable here: it would take more than an arm can have
_WHOLE_ARM = 10**6  # column of what does not sit on one joint: after every joint
METRICS = {"moving": "moving", "filtered": "filtered", "held_out": "as logged"}
_OVERALL = {"moving": "overall_moving", "filtered": "overall_filtered", "held_out": "overall"}


def list_metrics(verdict: Verdict) -> list[str]:
    """Return the kinds of error that are known, the best one first."""
    return [m for m in METRICS if any(s in STAGES for s in list_errors(verdict, m))]


def list_errors(verdict: Verdict, metric: str) -> dict[str, tuple[Number, ...]]:
    """Return by model the held-out errors [%]: of each joint, then of all."""
    joints = getattr(verdict.error, metric)
    overall = getattr(verdict.error, _OVERALL[metric])
    every = {
        stage: (*(joints.get(stage) or [None] * verdict.dof), overall.get(stage))
        for stage in (*STAGES, PLAIN)
    }
    return {stage: row for stage, row in every.items() if any(map(is_number, row))}


def build_error_table(diagnosis: Diagnosis, metrics: Sequence[str]) -> ReportTable | None:
    """Return errors by kind, then by model; None where none is known."""
    verdict, left = diagnosis.verdict, diagnosis.unexplained
    columns, groups = [], []
    for metric in metrics:
        errors = list_errors(verdict, metric)
        # Least squares, a reference, is shown for the first kind only.
        stages = [s for s in errors if s != PLAIN or metric == next(iter(METRICS))]
        columns += [(stage, errors[stage]) for stage in stages]
        groups.append((capitalize_first(METRICS[metric]), len(stages)))
    if not columns:
        return None
    labels = [
        f"{j}{', too small' if j in verdict.too_small else ''}" for j in range(1, verdict.dof + 1)
    ]
    cells = []
    for at, label in enumerate([*labels, "All"]):
        at = at if label != "All" else -1
        kinds = (BoldText if stage == "augmented" else str for stage, _ in columns)
        numbers = (format_percent_number(errors[at]) for _, errors in columns)
        cells.append([label, *(kind(n) for kind, n in zip(kinds, numbers, strict=True))])
    heads = ["Joint", *(stage.replace("_", " ") for stage, _ in columns)]
    shares = (*left.per_joint, left.fraction)
    if any(map(is_number, shares)):
        heads, groups = [*heads, "unexplained"], [*groups, ("", 1)]
        for joint, (row, share) in enumerate(zip(cells, shares, strict=True), 1):
            flag = "flagged " if joint in left.joints else ""
            percent = 100 * share if is_number(share) else None
            row.append(flag + format_percent_number(percent))
    sections, groups = (len(cells) - 1,), [("", 1), *groups]
    return ReportTable(heads, cells, sections=sections, groups=groups, look="tight errors")


def build_position_table(diagnosis: Diagnosis) -> ReportTable | None:
    """Return the position error of each model in free simulation, per joint."""
    position = diagnosis.errors.position
    if position is None:
        return None
    dof = diagnosis.verdict.dof
    rows = [
        (stage, *map(format_number, (*(rms or [None] * dof), position.overall[stage])))
        for stage, rms in position.rms.items()
    ]
    if dof >= _WIDEST:
        rows = [(row[0], row[-1]) for row in rows]
    heads = ("model", *(f"J{j}" for j in range(1, len(rows[0]) - 1)), "all")
    slides = any(diagnosis.torque_unit(j) == "N" for j in range(1, dof + 1))
    about = f"Position of each model by itself, rms error [{'rad, m' if slides else 'rad'}]"
    if position.left_out:
        nouns = [find_effect(name).noun for name in position.left_out]
        about += f", without {join_with_and(nouns)}"
    return ReportTable(heads, rows, about)


def describe_error_columns(diagnosis: Diagnosis) -> list[str]:
    """Return a line on each term of an error table that needs one."""
    left, lines = diagnosis.unexplained, []
    if any("plsr" in list_errors(diagnosis.verdict, metric) for metric in METRICS):
        lines.append("plsr: augmented, and tables fitted to the residual.")
    joints = enumerate(left.per_joint, 1)
    if any(j in left.joints and is_number(share) for j, share in joints):
        lines.append("flagged: the residual of this joint is larger than noise.")
    return lines


def title_finding(effect: Finding, verdict: Verdict) -> str:
    """Return a finding with its place and the names of its joints in the URDF."""
    known = verdict.frames.joints
    names = [(j, known[j - 1]) for j in effect.joints if j <= len(known)]
    plain = r"(?:.*[_-])?(?:joint|axis|j|a|q)?[_-]?0*{}"  # no more than the number
    telling = [n for j, n in names if not re.fullmatch(plain.format(j), n, re.IGNORECASE)]
    about = f" ({join_with_and(telling)})" if telling else ""
    return format_effect_place(effect, verdict.dof) + about


def build_parameter_table(effect: Finding, verdict: Verdict) -> ReportTable:
    """Return the sizes of a finding: a row per joint, or per parameter."""
    texts: dict[str, dict[int | None, str]] = {}  # by name, then by joint
    for size in list_finding_sizes(effect, verdict):
        texts.setdefault(size.name, {})[size.joint] = size.text
    texts |= {name: {None: str(p)} for name, p in effect.combinations.items()}
    joints = dict.fromkeys(j for by_joint in texts.values() for j in by_joint if j)
    if not joints:
        rows = [(name, by_joint[None]) for name, by_joint in texts.items()]
        return ReportTable(("Parameter", "Value"), rows)
    rows = [
        (f"Joint {j}", *(by_joint.get(j, MISSING) for by_joint in texts.values())) for j in joints
    ]
    return ReportTable(("On", *map(capitalize_first, texts)), rows)


def build_value_table(changes: Sequence[Change], verdict: Verdict) -> ReportTable:
    """Return nominal values beside identified ones."""
    rows = [
        (
            name_value(change, verdict),
            f"{format_number(change.nominal)} {format_unit(change.unit)}".strip(),
            format_uncertain_value(change.identified, change.std, change.unit),
            f"{100 * share:+.0f} %" if abs(share) < _HUGE else "",
        )
        for change in changes
        for share in [compute_change_share(change)]
    ]
    return build_text_table(("Value", "Nominal", "Identified", "Difference"), rows)


def build_detectable_table(verdict: Verdict) -> ReportTable:
    """Return the smallest detectable size of each effect, per joint.

    Effects on pairs of joints or on the whole arm get rows and a column of their own.
    """
    sizes: dict[str, dict[int, str]] = {}
    for item in verdict.minimum_detectable:
        local, unit = len(item.joints) == 1, format_unit(item.unit)
        name = " ".join([*item.name.split("_"), *map(str, item.joints[local:])])
        row = sizes.setdefault(f"{name} [{unit}]" if unit else name, {})
        size = "" if item.value is None else f"{item.value:.2g}"
        size = format_number(item.value) if is_number(item.value) and item.value >= 100 else size
        row[item.joints[0] if local else _WHOLE_ARM] = size or NEVER
    columns = sorted({column for row in sizes.values() for column in row})
    heads = ["arm" if c == _WHOLE_ARM else f"J{c}" for c in columns]
    rows = [[n, *(row.get(c, MISSING) for c in columns)] for n, row in sizes.items()]
    return ReportTable(["Effect", *heads], rows, look="tight sizes")


def format_split_count(effect: Finding) -> str:
    """Return how often a name came back without a part of the data: '3 of 3'."""
    splits = effect.evidence.splits
    return f"{splits.found} of {splits.of}" if splits and splits.of else ""


def build_evidence_table(diagnosis: Diagnosis) -> ReportTable:
    """Return how sure each finding is."""
    again = any(map(format_split_count, diagnosis.effects))
    heads = ["Effect", "Probability", "Evidence\n[nats]", "By", "Held-out\nmotion"]
    heads += ["Gain", *["Found\nagain"] * again]
    rows = []
    for effect in diagnosis.effects:
        proof, title = effect.evidence, title_finding(effect, diagnosis.verdict)
        name = capitalize_first(title)
        others = format_equivalent_phrases(effect, diagnosis.verdict.dof)
        name += f"\nor {' or '.join(others)}" if others else ""
        word = proof.held_out
        look = f"tag {word if word in ('confirmed', 'refuted') else 'neutral'}"
        row = [name, format_probability(effect.probability), format_number(proof.nats)]
        row += [proof.by or MISSING, html_tag("span", word or "not tested", look)]
        row += [format_fraction(proof.held_out_gain)]
        rows.append(row + [format_split_count(effect) or MISSING] * again)
    return ReportTable(heads, rows, text_columns=(0, 3, 4))


def describe_impact(diagnosis: Diagnosis, effect: Finding) -> str:
    """Return in one sentence the torque error without it; empty if unknown.

    Of at most two joints, those where its torque is largest.
    """
    clouds = [c for c in diagnosis.clouds if c.name == effect.name and len(c.x)]
    if find_effect(effect.name).variable is not None and effect.joints:
        clouds = [c for c in clouds if c.joint in effect.joints] or clouds
    peaks = sorted((float(np.abs(c.fitted).max()), c.joint) for c in clouds)[-2:]
    words = " and ".join(
        f"by up to {format_number(peak)} {diagnosis.torque_unit(joint)} on joint {joint}"
        for peak, joint in reversed(peaks)
    )
    return f"Without it the predicted torque is off {words}." if words else ""


# Sizes of a finding as engineers state them: a change, an amplitude, a frame.

_OPEN = "not determined"
_DIGITS = 3  # of the larger of two values, before and after
_STEP = 1e-3  # of a deviation, for derivatives


@dataclass(frozen=True, slots=True)
class FindingSize:
    """One size of a finding.

    Attributes:
        name: Its parameter in words.
        joint: Joint from 1; None where there is only one.
        value, std, unit: The size; the value None where it is not determined.
        change: The nominal value; None where the size is no change of one.
        signed: Whether it is the difference from a nominal value.
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
            return _OPEN
        text = format_uncertain_value(self.value, self.std, self.unit)
        if self.signed and self.value > 0 and not text.startswith("("):
            text = f"+{text}"
        if self.change is None:
            return text
        ends = self.change, self.change + self.value
        largest = max(map(abs, ends))
        places = max(_DIGITS - 1 - floor(log10(largest)), 0) if largest else 0
        return f"{text} ({' → '.join(f'{end:.{places}f}' for end in ends)})"


def list_finding_sizes(effect: Finding, verdict: Verdict) -> list[FindingSize]:
    """Return the sizes of a finding, in the form that its effect file gives them."""
    parts = list(_sizes(effect))
    if not is_wrong_value(effect, verdict):
        return parts
    out = []
    for size in parts:
        joints = effect.joints if size.joint is None else (size.joint,)
        place = effect.name, tuple(joints), size.name
        nominal = [
            c.nominal
            for c in verdict.changes
            if (c.name, tuple(c.joints), c.parameter.replace("_", " ")) == place
            and is_number(c.nominal)
        ]
        change = nominal[-1] if nominal else None
        out.append(replace(size, change=change, signed=True))
    return out


def _sizes(effect: Finding) -> Iterator[FindingSize]:
    """Sizes by parameter, or as the effect converts them, deviations independent."""
    several = any(isinstance(p.value, tuple) for p in effect.parameters.values())
    joints = effect.joints if several else (None,)
    convert = find_effect(effect.name).display
    parameters = effect.parameters.values()
    if (
        convert is None
        or not all(p.determined for p in parameters)
        or not all(is_number(v) for p in parameters for v, _ in p.pairs)
    ):
        for key, parameter in effect.parameters.items():
            name, unit = key.replace("_", " "), parameter.unit
            for joint, (value, std) in zip(joints, parameter.pairs, strict=False):
                size = value if parameter.determined else None
                yield FindingSize(name, joint, size, std, unit)
        return
    pairs = zip(*(p.pairs for p in parameters), strict=True)
    for joint, joint_values in zip(joints, pairs, strict=False):
        values = np.array([v for v, _ in joint_values], dtype=float)
        stds = np.array([s if is_number(s) else 0.0 for _, s in joint_values])
        steps = [convert(values + row) for row in _STEP * np.diag(stds)]
        for name, (value, unit) in convert(values).items():
            slopes = [(step[name][0] - value) / _STEP for step in steps]
            yield FindingSize(name, joint, value, float(np.linalg.norm(slopes)), unit)


def format_first_size(effect: Finding, verdict: Verdict) -> tuple[str, str]:
    """Return (name, value) of the first size that the logs determine.

    Of several joints the smallest and the largest value.
    """
    determined = [size for size in list_finding_sizes(effect, verdict) if is_number(size.value)]
    if not determined:
        return "", MISSING
    first = determined[0]
    same = [size for size in determined if size.name == first.name]
    if len(same) == 1:
        return first.name, first.text
    low, high = (f(size.value for size in same) for f in (min, max))
    sign = "+" if first.signed and low > 0 else ""
    span = f"{sign}{format_number(low)} to {sign}{format_number(high)} {format_unit(first.unit)}"
    return first.name, span.strip()
