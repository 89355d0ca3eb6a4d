"""A diagnosis in the terminal and on a page: the verdict first, then its grounds.

Each section is a function; page and terminal draw the same document.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from markupsafe import Markup
from rich.console import Console

from flows.report import (
    Chart,
    Document,
    Facts,
    FoldedParts,
    Heading,
    HeadlineFigure,
    Note,
    Pairs,
    Part,
    Section,
    SideBySide,
    build_text_table,
    html_tag,
    print_document,
    print_line,
    sentences,
    tables,
)
from flows.report.phrases import (
    WEIGH_LOAD,
    HiddenEffect,
    build_truth_rows,
    capitalize_first,
    compare_with_truth,
    count_noun,
    describe_edit_tests,
    find_effect,
    format_effect_noun,
    format_equivalent_phrases,
    is_link_or_load,
    read_page_texts,
)
from flows.report.sentences import MORE_MOTION, list_wrong_values
from residual.quantity import MISSING, format_fraction, format_number, format_probability, is_number
from residual.verdict.result import Diagnosis, Verdict

_TEXT = read_page_texts()["diagnosis"]
_MANY = 3  # findings from which tables and curves are folded
_LISTED = 8  # parents of one role
_OPEN = 3  # figures of the first finding that are not


class DiagnosisFigures(NamedTuple):
    """The figures of a diagnosis, for a page only."""

    errors: Chart | None  # held-out errors
    findings: Sequence[Sequence[Chart]]  # of each finding
    motions: Sequence[tuple[str, list[Chart]]]  # held-out logs, with their labels
    undrawn: int  # held-out logs that are not drawn
    residual: Sequence[Chart]  # of what no effect explains


def print_diagnosis(result: Diagnosis, console: Console) -> None:
    """Print a diagnosis: verdict, findings, errors, remainder, next experiment."""
    print_document(console, build_diagnosis_document(result))
    print_line(console, "")


def describe_parents(parents: Sequence[Mapping]) -> list[str]:
    """Return a line for each role of the records that a diagnosis is made from."""
    by_role: dict[str, list[str]] = {}
    for parent in parents:
        by_role.setdefault(parent["role"], []).append(parent["parent"][:8])
    more = {role: len(ids) - _LISTED for role, ids in by_role.items()}
    return [
        f"{role}: {', '.join(ids[:_LISTED])}"
        + (f" and {more[role]} more" if more[role] > 0 else "")
        for role, ids in by_role.items()
    ]


def build_diagnosis_document(
    result: Diagnosis,
    robot: str = "",
    hidden: Sequence[HiddenEffect] | None = None,
    origin: Pairs = (),
    records: Sequence[str] = (),
    figures: DiagnosisFigures | None = None,
) -> Document:
    """Return a diagnosis as a document.

    Args:
        hidden: What was under the seal of a demonstration; None for any other diagnosis.
        origin: Where it comes from, and the command that makes it again.
        records: How often the arm's stored diagnoses had each finding, a sentence each.
        figures: Those of a page; None for a terminal.
    """
    verdict = result.verdict
    truth = () if hidden is None else build_truth_parts(hidden, verdict)
    first, *lead = sentences.list_headline_sentences(verdict)
    weak = [_TEXT["weak"]] if verdict.error.same_run and figures else []
    sections = (
        Section("demonstration", "The hidden effect", truth),
        _missing(result, figures.findings if figures else None, records),
        _errors(result, figures and figures.errors),
        _curves(result, *((figures.motions, figures.undrawn) if figures else ((), 0))),
        _alternatives(result),
        _evidence(result),
        _nominal_values(verdict),
        _unexplained(verdict, figures.residual if figures else ()),
        _detectable(verdict),
        Section("notes", "Processing of the logs", [result.notes], open=False, printed=False),
        _origin(verdict, origin),
        _terms(verdict),
    )
    return Document(
        title=f"modelgap: {robot}",
        about=Markup("modelgap diagnosis of <b>{}</b>").format(robot),
        headline=first,
        lead=[" ".join(lead)] if lead else (),
        next_step=describe_next_step(verdict),
        tiles=build_tiles(result),
        warnings=[*weak, *verdict.warnings],
        sections=sections,
    )


def build_tiles(result: Diagnosis) -> tuple[HeadlineFigure | None, ...]:
    """Return up to four figures: size, error, probability, remainder."""
    verdict, named, unexplained = result.verdict, result.effects, result.unexplained
    size = sure = remaining = None
    if len(named) == 1:
        (f,) = named
        name, value = tables.format_first_size(f, verdict)
        of = f"of {tables.title_finding(f, verdict)}"
        size = HeadlineFigure(capitalize_first(name), value, of) if name else None
        either = [format_effect_noun(f.name), *format_equivalent_phrases(f, verdict.dof)]
        note = f"that it is {' or '.join(either)}"
        sure = HeadlineFigure("Probability", format_probability(f.probability), note)
    elif named:
        confirmed = sum(f.evidence.held_out == "confirmed" for f in named)
        note = f"{confirmed} of them confirmed on unseen motion"
        size = HeadlineFigure("Effects found", str(len(named)), note)
        likely = [f.probability for f in named if is_number(f.probability)]
        weakest = format_probability(min(likely, default=None))
        sure = HeadlineFigure("Probability", weakest, "of the least certain name")
    stages = f"nominal → {sentences.format_augmented_label(verdict) if named else 'refit'}"
    fall = sentences.format_error_change(verdict)
    error = HeadlineFigure("Error on unseen motion", fall or MISSING, f"of the torque, {stages}")
    if is_number(unexplained.fraction):
        noise = f"; noise alone is {format_fraction(unexplained.noise_floor)}"
        note = f"of the torque{noise if is_number(unexplained.noise_floor) else ''}"
        remaining = HeadlineFigure("Unexplained", format_fraction(unexplained.fraction), note)
    return size, error, sure, remaining


def _fold(parts: Sequence[Chart], title: str, grid: bool = True) -> FoldedParts | None:
    """More figures, which open at a click; in a grid where they are small."""
    shown = f"{title} ({count_noun(len(parts), 'figure')})"
    return FoldedParts(shown, [parts] if grid else parts) if parts else None


def build_truth_parts(hidden: Sequence[HiddenEffect], verdict: Verdict) -> list[Part]:
    """Return the hidden effect beside the named one."""
    title = "The seal, opened after the verdict was stored"
    text = read_page_texts()["judged"]
    return [
        build_text_table(("", "hidden", "named"), build_truth_rows(hidden, verdict), title),
        Note(text[compare_with_truth(hidden, verdict)], "callout"),
        *([Note(text["forms"])] if hidden and verdict.effects else []),
    ]


def _missing(
    result: Diagnosis, figures: Sequence[Sequence[Chart]] | None, records: Sequence[str]
) -> Section:
    parts: list[Part | None] = []
    for at in range(len(result.effects)):
        charts_of_finding = figures[at] if figures else ()
        parts += _finding(result, at, charts_of_finding, "".join(records[at : at + 1]))
    note = _TEXT["clouds"] if figures and any(figures) else ""
    return Section("missing", "What is missing", parts, note)


def _finding(
    result: Diagnosis, at: int, figures: Sequence[Chart], record: str
) -> list[Part | None]:
    """One finding: its effect on the torque, its size, its figures."""
    effect, verdict = result.effects[at], result.verdict
    sentence = capitalize_first("".join(result.sentences[at : at + 1]).strip())
    sentence += "." if sentence and sentence[-1] not in ".!?" else ""
    text: list[Part | None] = [sentence, tables.describe_impact(result, effect), record or None]
    if effect.equivalent:
        motion = "another motion may separate them"
        alike = Markup(
            "<b>These logs cannot separate {} from {}.</b> The probability is that of "
            "all of them together; {}."
        ).format(
            format_effect_noun(effect.name),
            " or from ".join(format_equivalent_phrases(effect, verdict.dof)),
            WEIGH_LOAD if is_link_or_load(effect) else motion,
        )
        text.append(Note(alike, "callout"))
    if effect.parameters or effect.combinations:
        flange = verdict.frames.flange or "the flange"
        frame = find_effect(effect.name).frame.format(flange=flange)
        text.append(tables.build_parameter_table(effect, verdict))
        text.append(Note(f"Vectors are {frame}.") if frame else None)
    title = capitalize_first(tables.title_finding(effect, verdict))
    heading = Heading(f"{effect.order}. {title}")
    if len(figures) == 1:
        return [heading, SideBySide((text, figures))]
    shown = _OPEN if at == 0 else 0
    more = "The other joints" if shown else "What it explains, joint by joint"
    return [heading, *text, figures[:shown], _fold(figures[shown:], more)]


def _errors(result: Diagnosis, bars: Chart | None) -> Section:
    metrics = tables.list_metrics(result.verdict)
    few, first = len(result.effects) < _MANY, metrics[:1]
    brief = [tables.build_error_table(result, first)]
    brief += tables.describe_error_columns(result)
    more = tables.build_error_table(result, metrics[1:])
    parts: list[Part | None] = [
        bars,
        FoldedParts("The errors of each joint", brief, few, True) if metrics else None,
        FoldedParts("Filtered and as logged", [more]) if more else None,
        tables.build_position_table(result),
    ]
    after = _TEXT["after" if result.effects else "no_after"]
    note = _TEXT["stages"].format(after) if bars else ""
    weak = ", end of the fitted run" if result.errors.same_run else ""
    kinds = "".join(f" ({tables.METRICS[kind]}{weak})" for kind in first)
    heading = f"Error on unseen motion{kinds}, % of the torque"
    return Section("proof", heading, parts, note)


def _curves(result: Diagnosis, motions: Sequence[tuple[str, list[Chart]]], undrawn: int) -> Section:
    note, parts, count = _TEXT["curves"], [], len(motions)
    if undrawn:
        note += _TEXT["undrawn"].format(count, count + undrawn)
    for at, (label, figures) in enumerate(motions, 1):
        number_of = f" {at}" if count > 1 else ""
        title = Markup("Held-out motion{} {}").format(number_of, html_tag("code", label))
        first = 1 if at == 1 else 0
        more = "The other joints" if first else "All joints"
        parts += [Heading(title), *figures[:first]]
        parts.append(_fold(figures[first:], more, False))
    few = len(result.effects) < _MANY - 1
    return Section("curves", "Measured and predicted torque", parts, note, open=few)


def _alternatives(result: Diagnosis) -> Section:
    sets = sentences.describe_alternative_sets(result.verdict)
    plan = sentences.describe_next_experiment(result.verdict)
    parts: list[Part] = [sets]
    if plan:
        none = "No other set of effects explains these logs as well."
        sole = result.effects and not any(f.equivalent for f in result.effects)
        parts += [none] if sole and not sets else []
        parts += [Heading("Next experiment"), plan]
    return Section("else", "Alternatives and next experiment", parts)


def _evidence(result: Diagnosis) -> Section:
    parts: list[Part] = [tables.build_evidence_table(result)] if result.effects else []
    edits = describe_edit_tests(result.verdict)
    if parts and edits:
        parts += [Heading("The edit test"), Note(_TEXT["edits"]), edits]
    return Section("evidence", "Evidence", parts, open=len(result.effects) < _MANY)


def _nominal_values(verdict: Verdict) -> Section:
    off, most = sentences.list_wrong_values(verdict), sentences.MOST_VALUES
    title = f"All {len(verdict.changes)} values, nominal and identified"
    folded = FoldedParts(title, [tables.build_value_table(verdict.changes, verdict)])
    if not off:
        parts = [_TEXT["none_off"], folded] if verdict.changes else ()
        return Section("given", "Nominal values", parts, printed=False)
    more = f"And {len(off) - most} more: see 'changes' in the JSON."
    parts = [
        tables.build_value_table(off[:most], verdict),
        Note(more, "soft spaced") if len(off) > most else None,
        folded,
    ]
    heading = "Nominal values contradicted by the logs"
    return Section("given", heading, parts, _TEXT["given"])


def _unexplained(verdict: Verdict, figures: Sequence[Chart]) -> Section:
    text = " ".join(sentences.describe_unexplained(verdict))
    about = Note(_TEXT["left"], "soft spaced") if figures else None
    parts = [text, about, figures] if text else ()
    return Section("left", "Unexplained torque", parts)


def _detectable(verdict: Verdict) -> Section:
    table = tables.build_detectable_table(verdict)
    heading = "Smallest detectable size of each effect"
    if not table.rows:
        return Section("sizes", heading, ())
    hidden = any(tables.NEVER in row for row in table.rows)
    never = f"{tables.NEVER}: not detectable in these logs at any plausible size."
    parts = [table, Note(never, "soft spaced") if hidden else None]
    none = not verdict.effects
    return Section("sizes", heading, parts, _TEXT["sizes"], open=none, printed=none)


def _origin(verdict: Verdict, origin: Pairs) -> Section:
    """The assumptions, the logs, and the command."""
    declared, logs = ", ".join(verdict.declared), ", ".join(verdict.error.logs)
    note = f"Declared in the model: {declared or 'rigid body only'}."
    note += f" Held out: {logs}." if logs else ""
    if is_number(verdict.nominal_scale):
        scale = f"{100 * verdict.nominal_scale:.3g} %"
        note += f" Assumed spread of the nominal parameters: {scale}."
    facts = Facts(origin) if origin else None
    return Section("origin", "Origin of this page", [Note(note), facts], open=False, printed=False)


def _terms(verdict: Verdict) -> Section:
    """The terms of the page."""
    cutoff = format_number(verdict.error.cutoff_hz)
    at = "" if cutoff == MISSING else f" at {cutoff} Hz"
    terms = {word: text.format(cutoff=at) for word, text in read_page_texts()["reading"].items()}
    more = Note("All terms: the glossary in CONTRIBUTING.md.", "soft spaced")
    return Section("read", "How to read this page", [terms, more], open=False, printed=False)


# Words in capitals in a command are for the reader to fill in.
_LOGS = "LOG... --robot ROBOT"


def describe_next_step(verdict: Verdict) -> tuple[str, str]:
    """Return what to do next, in words, and the command that does it."""
    faults = verdict.log_check.faults if verdict.log_check else ()
    again = f"modelgap diagnose {_LOGS}"
    alike = {is_link_or_load(f) for f in verdict.effects if f.equivalent}
    if not verdict.trusted or any(fault.repair for fault in faults):
        return "apply the fix that the check proposes", f"modelgap check {_LOGS}"
    if any(fault.kind in MORE_MOTION for fault in faults):
        program = "modelgap trajectory fourier --robot ROBOT --out MOTION.csv"
        return "log a motion that shows more", program
    if alike == {True}:
        return "weigh the load and say so", f"{again} --known payload.mass=KG"
    if verdict.next_experiment or alike or verdict.suspected:
        motion = f"modelgap next VERDICT.json {_LOGS}"
        return "look for the motion that settles what is open", motion
    if verdict.verdict == "unknown":
        return "compare with healthy logs", f"{again} --baseline HEALTHY_LOG..."
    if verdict.error.same_run:
        return "prove it on a log that was not fitted", f"{again} --holdout OTHER_LOG"
    if verdict.effects:
        return "save the augmented model", f"{again} --save-model MODEL.json"
    if list_wrong_values(verdict):
        return "write the identified robot", f"modelgap identify {_LOGS} --out DIR"
    later = f"modelgap diagnose NEW_{_LOGS} --baseline LOG..."
    return "compare later logs with these", later
