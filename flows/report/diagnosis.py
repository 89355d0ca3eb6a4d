"""A diagnosis in the terminal and on a page: the verdict first, then its grounds.

Each section is a function; its ``brief`` is the terminal's form.
"""

import base64
from collections.abc import Sequence

from markupsafe import Markup
from rich.console import Console

from flows.report import charts, tables
from flows.report.console import line, print_document, show
from flows.report.document import (
    Beside,
    Chart,
    Document,
    Facts,
    Fold,
    Heading,
    Note,
    Part,
    Section,
    Table,
    Tile,
    tag,
    words_table,
)
from flows.report.page import Pairs
from flows.report.page import render as render_page
from flows.report.words import outlook
from flows.report.words import verdict as words
from flows.report.words.phrases import (
    Staged,
    baseline_sentences,
    edit_sentence,
    judge,
    many,
    noun,
    sentence_case,
    texts,
    truth_rows,
)
from residual.diagnosis.result import Change, Diagnosis, Verdict
from residual.quantity import MISSING, fraction, known, number, probability

_TEXT = texts()["diagnosis"]
_MANY = 3  # findings from which tables and curves are folded
_OPEN = 3  # figures of the first finding that are not


def render(
    result: Diagnosis,
    robot_name: str,
    staged: Staged | None = None,
    origin: Pairs = (),
) -> str:
    """Return the report page: one HTML document, the same bytes every time.

    Args:
        origin: Where it comes from, and the command that makes it again.
    """
    return render_page(document(result, robot_name, staged, origin))


def print_diagnosis(result: Diagnosis, console: Console) -> None:
    """Print a diagnosis: verdict, findings, errors, remainder, next experiment.

    Args:
        console: Where to print; 80 columns and no color are enough.
    """
    report = document(result, drawn=False)
    first = ("missing", "given", "proof", "left", "sizes")
    print_document(console, report, first, ("else",))
    line(console, "")


def document(
    result: Diagnosis,
    robot: str = "",
    staged: Staged | None = None,
    origin: Pairs = (),
    drawn: bool = True,
) -> Document:
    """Return a diagnosis as a document.

    Args:
        drawn: Whether it has its figures, which no terminal needs.
    """
    verdict = result.verdict
    first, *lead = words.sentences(verdict)
    weak = [_TEXT["weak"]] if verdict.error.same_run and drawn else []
    sections = (
        _staged(staged),
        _missing(result, charts.finding_charts(result) if drawn else ()),
        _proof(result, charts.error_chart(result) if drawn else None),
        _curves(result, *(charts.motions(result) if drawn else ((), 0))),
        _else(result),
        _evidence(result),
        _given(verdict),
        _left(verdict, charts.left_charts(result) if drawn else ()),
        _sizes(verdict),
        Section("notes", "Processing of the logs", [result.notes], open=False),
        _origin(verdict, origin),
        _read(verdict),
    )
    return Document(
        title=f"modelgap: {robot}",
        about=Markup("modelgap diagnosis of <b>{}</b>").format(robot),
        headline=first,
        lead=[" ".join(lead)] if lead else (),
        tiles=tiles_of(result),
        warnings=[*weak, *verdict.warnings],
        sections=sections,
    )


def tiles_of(result: Diagnosis) -> tuple[Tile | None, ...]:
    """Return up to four figures: size, error, probability, remainder."""
    verdict, named, rest = result.verdict, result.effects, result.unexplained
    size = sure = left = None
    if len(named) == 1:
        (one,) = named
        name, value = tables.size_of(one, verdict)
        of = f"of {tables.title(one, verdict)}"
        size = Tile(sentence_case(name), value, of) if name else None
        other = f" or {tables.others(one, result)}" if one.equivalent else ""
        note = f"that it is {noun(one.name)}{other}"
        sure = Tile("Probability", probability(one.probability), note)
    elif named:
        confirmed = sum(one.evidence.held_out == "confirmed" for one in named)
        note = f"{confirmed} of them confirmed on unseen motion"
        size = Tile("Effects found", str(len(named)), note)
        likely = [one.probability for one in named if known(one.probability)]
        weakest = probability(min(likely, default=None))
        sure = Tile("Probability", weakest, "of the least certain name")
    stages = f"nominal → {words.with_findings(verdict) if named else 'refit'}"
    fall = words.errors(verdict)
    error = Tile("Error on unseen motion", fall or MISSING, f"of the torque, {stages}")
    if known(rest.fraction):
        noise = f"; noise alone is {fraction(rest.noise_floor)}"
        note = f"of the torque{noise if known(rest.noise_floor) else ''}"
        left = Tile("Unexplained", fraction(rest.fraction), note)
    return size, error, sure, left


def _folded(figures: Sequence[Chart], title: str, grid: bool = True) -> Fold | None:
    """More figures, which open at a click; in a grid where they are small."""
    shown = f"{title} ({many(len(figures), 'figure')})"
    return Fold(shown, [figures] if grid else figures) if figures else None


def truth(staged: Staged) -> list[Part]:
    """Return the hidden effect beside the named one."""
    title = "The seal, opened after the verdict was stored"
    text, hidden = texts()["judged"], staged.hidden
    edits = [edit_sentence(h.edit) for h in hidden if h.edit is not None]
    return [
        words_table(("", "hidden", "named"), truth_rows(staged), title),
        Note(text[judge(hidden, staged.verdict)], "callout"),
        *edits,
        *([Note(text["forms"])] if hidden and staged.verdict.effects else []),
    ]


def print_truth(staged: Staged, console: Console) -> None:
    """Print the hidden effect beside the named one."""
    show(console, *truth(staged), wrapped=True)


def _staged(staged: Staged | None) -> Section:
    parts: list[Part] = []
    if staged:
        alt = "The simulated arm moves through a part of one experiment"
        uri = "data:image/gif;base64," + base64.b64encode(staged.gif).decode()
        gif = [Chart(uri, alt, staged.caption)] if staged.gif else []
        parts = [Beside((gif, truth(staged)))]
    return Section("staged", "The experiment and the hidden effect", parts)


def _missing(result: Diagnosis, figures: Sequence[Sequence[Chart]]) -> Section:
    parts: list[Part | None] = []
    for at, own in enumerate(figures):
        parts += _finding(result, at, own)
    note = _TEXT["clouds"] if any(figures) else ""
    brief = [Heading("What is missing")] if result.effects else []
    for effect in result.effects:
        brief += tables.finding_lines(effect, result)
    brief += outlook.other_sets(result.verdict) if result.effects else ()
    brief += baseline_sentences(result.verdict)
    return Section("missing", "What is missing", parts, note, brief=brief)


def _finding(result: Diagnosis, at: int, figures: Sequence[Chart]) -> list[Part | None]:
    """One finding: what it does, its size, its figures."""
    effect, verdict = result.effects[at], result.verdict
    sentence = sentence_case("".join(result.sentences[at : at + 1]).strip())
    sentence += "." if sentence and sentence[-1] not in ".!?" else ""
    text: list[Part | None] = [sentence, tables.means(result, effect)]
    if effect.equivalent:
        alike = Markup(
            "<b>These logs cannot separate {} from {}.</b> The probability is that of "
            "all of them together; another motion may separate them."
        ).format(noun(effect.name), tables.others(effect, result, " or from "))
        text.append(Note(alike, "callout"))
    if effect.parameters or effect.combinations:
        frame = tables.frame_words(effect, verdict.frames)
        text.append(tables.parameter_table(effect, verdict))
        text.append(Note(f"Vectors are {frame}.") if frame else None)
    title = sentence_case(tables.title(effect, verdict))
    heading = Heading(f"{effect.order}. {title}")
    if len(figures) == 1:
        return [heading, Beside((text, figures))]
    shown = _OPEN if at == 0 else 0
    more = "The other joints" if shown else "What it explains, joint by joint"
    return [heading, *text, figures[:shown], _folded(figures[shown:], more)]


def _proof(result: Diagnosis, bars: Chart | None) -> Section:
    rows, worse = tables.error_rows(result), ", ".join(words.rising(result.verdict))
    worse = worse and f"The findings raise the error (moving) on {worse}."
    about = "Error on unseen motion, % of the measured torque"
    table = tables.error_table(rows, tables.METRICS, about)
    few = len(result.effects) < _MANY
    parts: list[Part | None] = [
        bars,
        Fold("The errors of each joint", [table], few) if table else None,
    ]
    parts += [Note(worse, "callout")] if worse and any(parts) else []
    after = _TEXT["after" if result.effects else "no_after"]
    note = _TEXT["stages"].format(after) if bars else ""
    brief = [tables.brief_errors(result, rows)]
    return Section("proof", "Error on unseen motion", parts, note, brief=brief)


def _curves(
    result: Diagnosis, motions: Sequence[tuple[str, list[Chart]]], undrawn: int
) -> Section:
    note, parts, count = _TEXT["curves"], [], len(motions)
    if undrawn:
        note += _TEXT["undrawn"].format(count, count + undrawn)
    for at, (label, figures) in enumerate(motions, 1):
        number_of = f" {at}" if count > 1 else ""
        title = Markup("Held-out motion{} {}").format(number_of, tag("code", label))
        first = 1 if at == 1 else 0
        more = "The other joints" if first else "All joints"
        parts += [Heading(title), *figures[:first]]
        parts.append(_folded(figures[first:], more, False))
    few = len(result.effects) < _MANY - 1
    return Section("curves", "Measured and predicted torque", parts, note, open=few)


def _else(result: Diagnosis) -> Section:
    parts: list[Part | None] = [outlook.other_sets(result.verdict)]
    plan, brief = outlook.next_words(result.verdict), []
    if plan:
        none = "No other set of effects explains these logs as well."
        parts += [none if result.effects and not parts[0] else None]
        parts += [Heading("Next experiment"), plan]
        brief = [Heading("Next experiment"), *(f"  {line}" for line in plan)]
    return Section("else", "Alternatives and next experiment", parts, brief=brief)


def _evidence(result: Diagnosis) -> Section:
    parts: list[Part] = [tables.evidence_table(result)] if result.effects else []
    edits = baseline_sentences(result.verdict)
    if parts and edits:
        parts += [Heading("The edit test"), Note(_TEXT["edits"]), edits]
    few = len(result.effects) < _MANY
    return Section("evidence", "Evidence", parts, open=few)


def _given(verdict: Verdict) -> Section:
    off, most = outlook.off(verdict), outlook.MOST_VALUES
    heads = ("Value", "Nominal", "Identified", "Difference")

    def table(changes: Sequence[Change], title: str = "") -> Table:
        return words_table(heads, outlook.value_rows(changes, verdict), title)

    title = f"All {len(verdict.changes)} values, nominal and identified"
    folded = Fold(title, [table(verdict.changes)])
    if not off:
        parts = [_TEXT["none_off"], folded] if verdict.changes else ()
        return Section("given", "Nominal values", parts)
    heading, more = "Nominal values contradicted by the logs", len(off) - most
    rest = f"And {more} more: see 'changes' in the JSON." * (more > 0)
    parts = [table(off[:most]), Note(rest, "soft spaced") if rest else None, folded]
    brief = [table(off[:most], heading), rest]
    return Section("given", heading, parts, _TEXT["given"], brief=brief)


def _left(verdict: Verdict, figures: Sequence[Chart]) -> Section:
    text = " ".join(outlook.unexplained_words(verdict))
    about = Note(_TEXT["left"], "soft spaced") if figures else None
    brief = [f"\n{text}" if text else ""]
    parts = [text, about, figures] if text else ()
    return Section("left", "Unexplained torque", parts, brief=brief)


def _sizes(verdict: Verdict) -> Section:
    heads, rows = outlook.detectable_rows(verdict)
    heading, nothing = "Smallest detectable size of each effect", not verdict.effects
    if not rows:
        return Section("sizes", heading, ())
    hidden = any(outlook.NEVER in row for row in rows)
    never = f"{outlook.NEVER}: not detectable in these logs at any plausible size."
    never = never if hidden else ""
    table = Table(heads, rows, heading, look="tight sizes")
    parts = [table, Note(never, "soft spaced") if never else None]
    printed = [table, never] if nothing else ()
    text = _TEXT["sizes"]
    return Section("sizes", heading, parts, text, open=nothing, brief=printed)


def _origin(verdict: Verdict, origin: Pairs) -> Section:
    """The assumptions, the logs, and the command."""
    declared, logs = ", ".join(verdict.declared), ", ".join(verdict.error.logs)
    note = f"Declared in the model: {declared or 'rigid body only'}."
    note += f" Held out: {logs}." if logs else ""
    if known(verdict.nominal_scale):
        scale = f"{100 * verdict.nominal_scale:.3g} %"
        note += f" Assumed spread of the nominal parameters: {scale}."
    facts = Facts(origin) if origin else None
    return Section("origin", "Origin of this page", [Note(note), facts], open=False)


def _read(verdict: Verdict) -> Section:
    """The terms of the page."""
    cutoff = number(verdict.error.cutoff_hz)
    at = "" if cutoff == MISSING else f" at {cutoff} Hz"
    terms = {word: text.format(cutoff=at) for word, text in texts()["reading"].items()}
    more = Note("All terms: the glossary in CONTRIBUTING.md.", "soft spaced")
    return Section("read", "How to read this page", [terms, more], open=False)
