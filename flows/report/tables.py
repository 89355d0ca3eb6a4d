"""The rows of every table of a diagnosis, and the sizes of a finding."""

import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import floor, log10

import numpy as np
from markupsafe import Markup

from flows.report.document import BoldText, ReportTable, html_tag
from flows.report.phrases import (
    capitalize_first,
    find_effect,
    format_effect_place,
    format_equivalent_phrases,
    join_with_and,
)
from flows.report.sentences import is_wrong_value
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
from residual.verdict.result import (
    PLAIN,
    STAGES,
    Diagnosis,
    Finding,
    Frames,
    Number,
    Verdict,
)

_WIDEST = 11  # columns of joints and their sum that a terminal shows
METRICS = {"moving": "moving", "filtered": "filtered", "held_out": "as logged"}


@dataclass(frozen=True, slots=True)
class ErrorRow:
    """Held-out error of one joint, or of all, per metric and stage [%]."""

    label: str
    joint: int | None
    values: Mapping[str, Mapping[str, float | None]]
    unexplained: float | None
    flagged: bool


def build_error_rows(diagnosis: Diagnosis) -> list[ErrorRow]:
    """Return one row per joint and one for all joints together."""
    unexplained, error = diagnosis.unexplained, diagnosis.errors
    rows = []
    for joint, share in enumerate(unexplained.per_joint, start=1):
        values = {
            metric: {k: v[joint - 1] for k, v in getattr(error, metric).items() if v}
            for metric in METRICS
        }
        small = ", too small" if joint in diagnosis.verdict.too_small else ""
        flagged = joint in unexplained.joints
        rows.append(ErrorRow(f"{joint}{small}", joint, values, share, flagged))
    overall = {
        "moving": error.overall_moving,
        "filtered": error.overall_filtered,
        "held_out": error.overall,
    }
    return [*rows, ErrorRow("all", None, overall, unexplained.fraction, False)]


def has_error(rows: Sequence[ErrorRow], metric: str, stage: str) -> bool:
    """Return whether any joint has this error."""
    return any(is_number(row.values[metric].get(stage)) for row in rows)


def build_error_table(
    rows: Sequence[ErrorRow], metrics: Collection[str], about: str
) -> ReportTable | None:
    """Return errors by metric, then by model; None where none is known.

    Args:
        about: Title of the table.
    """
    groups = {
        # Least squares, a reference, is shown for the first metric only.
        metric: [
            stage
            for stage in (*STAGES, *([PLAIN] if metric == next(iter(METRICS)) else []))
            if has_error(rows, metric, stage)
        ]
        for metric in metrics
    }
    columns = [(metric, stage) for metric, stages in groups.items() for stage in stages]
    if not columns:
        return None
    share = any(is_number(row.unexplained) for row in rows)
    cells = []
    for row in rows:
        line = [capitalize_first(row.label)]
        for metric, stage in columns:
            kind = BoldText if stage == "augmented" else str
            line.append(kind(format_percent_number(row.values[metric].get(stage))))
        if share:
            flag = "flagged " if row.flagged else ""
            remaining = row.unexplained
            line.append(
                flag
                + format_percent_number(
                    100 * remaining if is_number(remaining) else None
                )
            )
        cells.append(line)
    over = [
        (capitalize_first(METRICS[m]), len(shown))
        for m, shown in groups.items()
        if shown
    ]
    heads = [stage.replace("_", " ") for _, stage in columns]
    return ReportTable(
        ("Joint", *heads, *(["unexplained"] if share else [])),
        cells,
        about,
        sections=(len(cells) - 1,),
        groups=[("", 1), *over, *([("", 1)] if share else [])],
        look="tight errors",
    )


def build_position_table(diagnosis: Diagnosis) -> ReportTable | None:
    """Return how far each model by itself goes from the held-out motion, per joint."""
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
    about = (
        f"Position of each model by itself, rms error [{'rad, m' if slides else 'rad'}]"
    )
    if position.left_out:
        nouns = [find_effect(name).noun for name in position.left_out]
        about += f", without {join_with_and(nouns)}"
    return ReportTable(heads, rows, about)


def describe_error_columns(rows: Sequence[ErrorRow]) -> list[str]:
    """Return a line on each term of an error table that needs one."""
    lines = []
    if any(has_error(rows, metric, "plsr") for metric in METRICS):
        lines.append("plsr: augmented, and tables fitted to the residual.")
    if any(row.flagged and is_number(row.unexplained) for row in rows):
        lines.append("flagged: the residual of this joint is larger than noise.")
    return lines


def build_brief_error_table(
    diagnosis: Diagnosis, rows: Sequence[ErrorRow]
) -> ReportTable | None:
    """Return the errors of the first metric known; page and JSON have all."""
    key = next((m for m in METRICS if any(has_error(rows, m, s) for s in STAGES)), None)
    if key is None:
        return None
    weak = ", end of the fitted run" if diagnosis.errors.same_run else ""
    about = f"Error on unseen motion ({METRICS[key]}{weak}), % of torque"
    return build_error_table(rows, [key], about)


def build_stage_error_table(diagnosis: Diagnosis) -> ReportTable | None:
    """Return the errors of the first metric known, a row per model."""
    rows = build_error_rows(diagnosis)
    brief = build_brief_error_table(diagnosis, rows)
    if brief is None:
        return None
    metric = next(m for m in METRICS if any(has_error(rows, m, s) for s in STAGES))
    if len(rows) > _WIDEST:
        rows = rows[-1:]
    heads = ("model", *(f"J{row.joint}" if row.joint else "all" for row in rows))
    lines = [
        (stage, *(format_percent_number(r.values[metric].get(stage)) for r in rows))
        for stage in STAGES
        if has_error(rows, metric, stage)
    ]
    return ReportTable(heads, lines, brief.title)


def title_finding(effect: Finding, verdict: Verdict) -> str:
    """Return a finding with its place and the names of its joints in the URDF."""
    names = format_urdf_joint_names(effect.joints, verdict.frames)
    return format_effect_place(effect, verdict.dof) + (f" ({names})" if names else "")


def format_urdf_joint_names(joints: Iterable[int], frames: Frames) -> str:
    """Return the names of joints in the URDF, where a name is more than a number."""
    names = [(j, frames.joints[j - 1]) for j in joints if j <= len(frames.joints)]
    plain = r"(?:.*[_-])?(?:joint|axis|j|a|q)?[_-]?0*{}"
    return join_with_and(
        [n for j, n in names if not re.fullmatch(plain.format(j), n, re.IGNORECASE)]
    )


def format_equivalents(
    effect: Finding, diagnosis: Diagnosis, between: str = " or "
) -> str:
    """Return the equivalents of a finding in words."""
    return between.join(format_equivalent_phrases(effect, diagnosis.verdict.dof))


def build_parameter_table(effect: Finding, verdict: Verdict) -> ReportTable:
    """Return the sizes of a finding: a row per joint, or per parameter."""
    texts, about = _parameter_texts(effect, verdict), "Size, ± one standard deviation"
    joints = dict.fromkeys(j for by_joint in texts.values() for j in by_joint if j)
    if not joints:
        rows = [(name, by_joint[None]) for name, by_joint in texts.items()]
        return ReportTable(("Parameter", "Value"), rows, about)
    rows = [
        (f"Joint {j}", *(by_joint.get(j, MISSING) for by_joint in texts.values()))
        for j in joints
    ]
    return ReportTable(("On", *map(capitalize_first, texts)), rows, about)


def _parameter_texts(
    effect: Finding, verdict: Verdict
) -> dict[str, dict[int | None, str]]:
    """Text of each size by name, then by joint; joint None where it has only one."""
    texts: dict[str, dict[int | None, str]] = {}
    for size in list_finding_sizes(effect, verdict):
        texts.setdefault(size.name, {})[size.joint] = size.text
    combined = {name: {None: str(p)} for name, p in effect.combinations.items()}
    return texts | combined


def _size_lines(effect: Finding, verdict: Verdict) -> list[str]:
    lines = []
    for name, by_joint in _parameter_texts(effect, verdict).items():
        texts = [f"J{j} {text}" if j else text for j, text in by_joint.items()]
        lines.append(f"{name} {', '.join(texts)}")
    return lines


def describe_finding(effect: Finding, diagnosis: Diagnosis) -> list[str]:
    """Return a finding as a terminal has it: name, sizes, evidence, a line each."""
    verdict, evidence = diagnosis.verdict, effect.evidence
    lines = [BoldText(f"{effect.order}. {title_finding(effect, verdict)}")]
    if effect.equivalent:
        lines.append(f"   or {format_equivalents(effect, diagnosis)}")
    lines += [f"   {line}" for line in _size_lines(effect, verdict)]
    frame = describe_frame(effect, verdict.frames)
    lines += [f"   ({frame})"] if frame else []
    words = [f"evidence {format_number(evidence.nats)} nats"]
    words[0] += f" by {evidence.by}" if evidence.by else ""
    if is_number(effect.probability):
        scope = " (of any of these)" if effect.equivalent else ""
        words.append(f"probability {format_probability(effect.probability)}{scope}")
    words.append(f"held-out motion: {evidence.held_out or 'not tested'}")
    again = format_split_count(effect)
    words += [f"found again in {again} splits"] if again else []
    return [*lines, f"   {', '.join(words)}"]


def summarize_finding(effect: Finding, verdict: Verdict) -> str:
    """Return a finding in one line: name, sizes, probability, held-out motion."""
    sizes = _size_lines(effect, verdict)
    title = f"{effect.order}. {title_finding(effect, verdict)}"
    sure = f"probability {format_probability(effect.probability)}"
    motion = f"held-out motion: {effect.evidence.held_out or 'not tested'}"
    return f"{title}: {'; '.join([*sizes, sure, motion])}"


def format_split_count(effect: Finding) -> str:
    """Return how often a name came back without a part of the data: '3 of 3'."""
    splits = effect.evidence.splits
    return f"{splits.found} of {splits.of}" if splits and splits.of else ""


def build_evidence_table(diagnosis: Diagnosis) -> ReportTable:
    """Return how sure each finding is."""
    again = any(map(format_split_count, diagnosis.effects))
    heads = ["Effect", "Probability", "Evidence [nats]", "By", "Held-out motion"]
    heads += ["Gain", *["Found again"] * again]
    rows = []
    for effect in diagnosis.effects:
        proof, name = (
            effect.evidence,
            capitalize_first(title_finding(effect, diagnosis.verdict)),
        )
        if effect.equivalent:
            other = html_tag(
                "span", f"or {format_equivalents(effect, diagnosis)}", "soft"
            )
            name = Markup("{}<br>{}").format(name, other)
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
        f"by up to {format_number(peak)} {diagnosis.torque_unit(joint)} on joint "
        f"{joint}"
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
    determined = [
        size for size in list_finding_sizes(effect, verdict) if is_number(size.value)
    ]
    if not determined:
        return "", MISSING
    first = determined[0]
    same = [size for size in determined if size.name == first.name]
    if len(same) == 1:
        return first.name, first.text
    low, high = (f(size.value for size in same) for f in (min, max))
    sign = "+" if first.signed and low > 0 else ""
    span = (
        f"{sign}{format_number(low)} to {sign}{format_number(high)} "
        f"{format_unit(first.unit)}"
    )
    return first.name, span.strip()


def describe_frame(effect: Finding, frames: Frames) -> str:
    """Return the frame of the vectors of a finding; empty where it has none."""
    flange = frames.flange or "the flange"
    return find_effect(effect.name).frame.format(flange=flange)
