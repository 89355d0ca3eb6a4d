"""The rows of every table of a diagnosis, and what a finding means for the robot."""

import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import floor, log10
from textwrap import wrap

import numpy as np
from markupsafe import Markup

from flows.report.document import Strong, Table, tag
from flows.report.words.phrases import (
    alternatives,
    effect_named,
    listing,
    phrase,
    sentence_case,
)
from flows.report.words.verdict import is_wrong_value
from residual.diagnosis.result import (
    PLAIN,
    STAGES,
    Diagnosis,
    Finding,
    Frames,
    Number,
    Verdict,
)
from residual.quantity import (
    MISSING,
    bare_percent,
    fraction,
    known,
    measured,
    number,
    probability,
    unit_text,
)

METRICS = {"moving": "moving", "filtered": "filtered", "held_out": "as logged"}


@dataclass(frozen=True, slots=True)
class ErrorRow:
    """Held-out error of one joint, or of all, per metric and stage [%]."""

    label: str
    joint: int | None
    values: Mapping[str, Mapping[str, float | None]]
    unexplained: float | None
    flagged: bool


def error_rows(diagnosis: Diagnosis) -> list[ErrorRow]:
    """Return one row per joint and one for all joints together."""
    left, error = diagnosis.unexplained, diagnosis.errors
    rows = []
    for joint, share in enumerate(left.per_joint, start=1):
        values = {
            metric: {k: v[joint - 1] for k, v in getattr(error, metric).items() if v}
            for metric in METRICS
        }
        flagged = joint in left.joints
        small = ", too small" if joint in diagnosis.verdict.too_small else ""
        label = f"{joint}{small}"
        rows.append(ErrorRow(label, joint, values, _percent(share), flagged))
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


def title(effect: Finding, verdict: Verdict) -> str:
    """Return a finding with its place, and what the URDF calls its joints."""
    called = named_joints(effect.joints, verdict.frames)
    return phrase(effect, verdict.dof) + (f" ({called})" if called else "")


def parameter_table(effect: Finding, verdict: Verdict) -> Table:
    """Return the sizes of a finding: a row per joint, or per parameter."""
    rows, about = _parameters(effect, verdict), "Size, ± one standard deviation"
    joints = dict.fromkeys(joint for _, joint, _ in rows if joint is not None)
    if not joints:
        cells = [(name, text) for name, _, text in rows]
        return Table(("Parameter", "Value"), cells, about)
    names = list(dict.fromkeys(name for name, _, _ in rows))
    texts = {(name, joint): text for name, joint, text in rows}
    cells = [
        (f"Joint {j}", *(texts.get((name, j), MISSING) for name in names))
        for j in joints
    ]
    return Table(("On", *map(sentence_case, names)), cells, about)


def parameter_lines(effect: Finding, verdict: Verdict, width: int) -> list[str]:
    """Return the same as lines: a name, then its value or one per joint."""
    lines: list[str] = []
    last = ""
    for name, joint, text in _parameters(effect, verdict):
        if joint is None and len(f"{name} {text}") <= width:
            lines.append(f"{name} {text}")
            continue
        lines += [name] if name != last else []
        lines.append(f"  {text}" if joint is None else f"  J{joint} {text}")
        last = name
    return [*lines, *wrap(frame_words(effect, verdict.frames), width)]


def _parameters(effect: Finding, verdict: Verdict) -> list[tuple[str, int | None, str]]:
    """Name, joint and text of each size, by name; joint None where it has only one."""
    rows = [(o.name, o.joint, o.text) for o in sizes(effect, verdict)]
    rows += [(name, None, str(p)) for name, p in effect.combinations.items()]
    names = list(dict.fromkeys(name for name, _, _ in rows))
    return sorted(rows, key=lambda row: names.index(row[0]))


def found_again(effect: Finding) -> str:
    """How often a name came back without a part of the data: '3 of 3'."""
    splits = effect.evidence.splits
    return f"{splits.found} of {splits.of}" if splits and splits.of else ""


_CERTAIN = (0.999, 0.99)


def means(diagnosis: Diagnosis, effect: Finding) -> str:
    """Return in one sentence what a model without it gets wrong; empty if unknown.

    Of at most two joints, those where it is the largest share of the torque.
    """
    mine = [c for c in diagnosis.clouds if c.name == effect.name and len(c.x)]
    if effect_named(effect.name).variable is not None and effect.joints:
        mine = [c for c in mine if c.joint in effect.joints] or mine
    parts = []
    for cloud in mine:
        peak = float(np.abs(cloud.fitted).max())
        whole, unit = (
            _largest(diagnosis, cloud.joint),
            diagnosis.torque_unit(cloud.joint),
        )
        share = peak / whole if whole else 0.0
        words = f"by up to {number(peak)} {unit} on joint {cloud.joint}"
        of = f" ({fraction(share)} of the largest torque there)" if share else ""
        parts.append((share, words + of))
    worst = [words for _, words in sorted(parts, reverse=True)[:2]]
    words = f"Without it the predicted torque is off {' and '.join(worst)}."
    return words if worst else ""


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


def _largest(diagnosis: Diagnosis, joint: int) -> float | None:
    sizes = [
        float(np.abs(p.tau[:, joint - 1]).max())
        for p in diagnosis.proofs
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
        text = measured(self.value, self.std, self.unit)
        if self.signed and self.value > 0 and not text.startswith("("):
            text = f"+{text}"
        return text if self.change is None else f"{text} ({self.from_to})"

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
    sizes_of = effect_named(effect.name).display
    clear = all(p.determined for p in effect.parameters.values())
    parts = list(_told(effect) if sizes_of and clear else _plain(effect))
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
        others = [o for o in every[1:] if effect_named(effect.name).display]
        return name, ", ".join([same[0].text, *(f"{o.name} {o.text}" for o in others)])
    low, high = (f(one.value for one in same if known(one.value)) for f in (min, max))
    sign = "+" if same[0].signed and low > 0 else ""
    span = f"{sign}{number(low)} to {sign}{number(high)} {unit_text(same[0].unit)}"
    return name, span.strip()


def frame_words(effect: Finding, frames: Frames) -> str:
    """Return what the vectors of a finding are in; empty where it has none."""
    flange = frames.flange or "the flange"
    return effect_named(effect.name).frame.format(flange=flange)


def named_joints(joints: Iterable[int], frames: Frames) -> str:
    """Return what the URDF calls joints, where that says more than their numbers."""
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
    sizes_of = effect_named(effect.name).display
    pairs = [p.pairs for p in effect.parameters.values()]
    if sizes_of is None or any(not known(v) for own in pairs for v, _ in own):
        yield from _plain(effect)
        return
    for joint, own in zip(_joints(effect), zip(*pairs, strict=True), strict=False):
        values = np.array([v for v, _ in own], dtype=float)
        stds = np.array([s if known(s) else 0.0 for _, s in own])
        at, spread = sizes_of(values), dict.fromkeys(sizes_of(values), 0.0)
        for i, std in enumerate(stds):
            near = sizes_of(values + STEP * std * np.eye(len(values))[i])
            for name in at:
                spread[name] += ((near[name][0] - at[name][0]) / STEP) ** 2
        for name, (value, unit) in at.items():
            yield Size(name, joint, value, float(np.sqrt(spread[name])), unit)


def _changed(one: Size, key: str | None, effect: Finding, verdict: Verdict) -> Size:
    """A size as a change, from the value that the model was given where it was."""
    before = None
    on = effect.joints if one.joint is None else (one.joint,)
    for change in verdict.changes if key else ():
        given = change.name, tuple(change.joints), change.parameter
        if given == (effect.name, tuple(on), key):
            before = change.nominal if known(change.nominal) else None
    return Size(one.name, one.joint, one.value, one.std, one.unit, before, True)


# Tables of findings and of errors.


def others(effect: Finding, diagnosis: Diagnosis, between: str = " or ") -> str:
    """What an effect cannot be told from."""
    return between.join(alternatives(effect, diagnosis.verdict.dof))


_NARROW = 26  # characters of a size in the terminal


def findings_table(diagnosis: Diagnosis) -> list[Table]:
    """Return what was found as a terminal has it; none where nothing was."""
    verdict = diagnosis.verdict
    if not diagnosis.effects:
        return []
    sizes = [parameter_lines(e, verdict, _NARROW) for e in diagnosis.effects]
    rows = [
        (str(e.order), _effect_cell(e, diagnosis), "\n".join(size), _evidence_cell(e))
        for e, size in zip(diagnosis.effects, sizes, strict=True)
    ]
    # Short cells keep their width, so that no verdict is cut at 80 columns.
    widths = [len(line) for size in sizes for line in size]
    least = {2: max(widths, default=0), 3: len("held-out: confirmed")}
    heads = ("", "effect", "parameters", "evidence")
    return [Table(heads, rows, "What is missing", left=range(4), least=least)]


def _effect_cell(effect: Finding, diagnosis: Diagnosis) -> str:
    same = others(effect, diagnosis)
    tail = f"\nor {same}: these data cannot tell" if same else ""
    return Strong(title(effect, diagnosis.verdict) + tail)


def _evidence_cell(effect: Finding) -> str:
    evidence, again = effect.evidence, found_again(effect)
    lines = [f"{number(evidence.nats)} nats"]
    if evidence.by:
        lines.append(f"by {evidence.by}")
    if known(effect.probability):
        lines.append(f"this name: {probability(effect.probability)}")
    lines.append(f"held-out: {evidence.held_out or 'not tried'}")
    if again:
        lines.append(f"found again: {again}")
    return "\n".join(lines)


def error_table(
    lines: Sequence[ErrorRow], metrics: Collection[str], about: str
) -> Table | None:
    """Return errors by metric, then by model; None where none is known.

    Args:
        about: What they are of.
    """
    leading = next(iter(METRICS))
    groups = {
        # The reference stands beside the leading metric only.
        metric: [
            stage
            for stage in (*STAGES, *([PLAIN] if metric == leading else []))
            if has(lines, metric, stage)
        ]
        for metric in metrics
    }
    columns = [(metric, stage) for metric, own in groups.items() for stage in own]
    if not columns:
        return None
    share = any(known(line.unexplained) for line in lines)
    rows = []
    for row in lines:
        cells = [_error(row, metric, stage) for metric, stage in columns]
        flag = "flagged " if row.flagged else ""
        rest = [flag + bare_percent(row.unexplained)] if share else []
        rows.append((sentence_case(row.label), *cells, *rest))
    over = [(sentence_case(METRICS[m]), len(own)) for m, own in groups.items() if own]
    heads = [stage.replace("_", " ") for _, stage in columns]
    return Table(
        ("Joint", *heads, *(["Unexplained"] if share else [])),
        rows,
        about,
        sections=(len(rows) - 1,),
        groups=[("", 1), *over, *([("", 1)] if share else [])],
        look="tight errors",
    )


def brief_errors(diagnosis: Diagnosis, lines: Sequence[ErrorRow]) -> Table | None:
    """Return the errors of the first metric known; page and JSON have all."""
    first = next((m for m in METRICS if any(has(lines, m, s) for s in STAGES)), None)
    if first is None:
        return None
    where = f" on {', '.join(diagnosis.errors.logs)}" if diagnosis.errors.logs else ""
    weak = " (the same run: a weak proof)" if diagnosis.errors.same_run else ""
    about = f"Held-out error{where}{weak}, {METRICS[first]}, % of torque"
    return error_table(lines, [first], about)


def _error(row: ErrorRow, metric: str, stage: str) -> str:
    kind = Strong if stage == "augmented" else str
    return kind(bare_percent(row.values[metric].get(stage)))


def evidence_table(diagnosis: Diagnosis) -> Table:
    """Return how sure each finding is."""
    named = diagnosis.effects
    again = any(map(found_again, named))
    heads = ["Effect", "Probability", "Evidence, nats", "By", "Held-out motion", "Gain"]
    heads += ["Found again"] * again
    rows = []
    for effect in named:
        evidence = effect.evidence
        row = [_class_cell(effect, diagnosis), probability(effect.probability)]
        row += [number(evidence.nats), evidence.by or MISSING, _tag(evidence.held_out)]
        row += [fraction(evidence.held_out_gain)]
        row += [found_again(effect) or MISSING] * again
        rows.append(row)
    return Table(heads, rows, left=(0, 3, 4))


def _class_cell(effect: Finding, diagnosis: Diagnosis) -> str:
    name = sentence_case(title(effect, diagnosis.verdict))
    other = tag("span", f"or {others(effect, diagnosis)}", "soft")
    return Markup("{}<br>{}").format(name, other) if effect.equivalent else name


def _tag(word: str | None) -> Markup:
    kinds = ("confirmed", "refuted")
    look = f"tag {word if word in kinds else 'neutral'}"
    return tag("span", word or "not tried", look)
