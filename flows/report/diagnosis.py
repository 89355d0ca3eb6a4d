"""A diagnosis in the terminal and on a page: the verdict first, then what is behind.

Each section is a function; what the terminal has of it is its ``brief``.
"""

from collections.abc import Sequence

from markupsafe import Markup
from rich.console import Console

from flows.report import charts, tables
from flows.report.console import line, print_document, show
from flows.report.document import (
    Beside,
    Callout,
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
from flows.report.tables import sure
from flows.report.words import outlook
from flows.report.words import verdict as words
from flows.report.words.phrases import (
    Staged,
    baseline_sentences,
    many,
    noun,
    sentence_case,
    texts,
)
from flows.report.words.verdict import held_out_words, rising
from residual.diagnosis.result import Change, Diagnosis, Finding, Verdict
from residual.quantity import MISSING, fraction, known, number, percent

_TEXT = texts()["diagnosis"]

_MANY = 3  # findings from which tables and curves are folded
_OPEN = 3  # figures of the first finding that are not
_NEVER = f"{outlook.NEVER}: not detectable here; no arm has so much."


def render(
    result: Diagnosis,
    robot_name: str,
    staged: Staged | None = None,
    origin: Pairs = (),
) -> str:
    """Return the report page.

    Args:
        origin: Where it comes from, and what makes the page again.

    Returns:
        One self-contained HTML document; the same diagnosis gives the same bytes.
    """
    return render_page(document(result, robot_name, staged, origin))


def print_diagnosis(result: Diagnosis, console: Console) -> None:
    """Print a diagnosis: verdict, findings, errors, what is left, what to do next.

    Args:
        console: Where to print; 80 columns and no colour are enough.
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
    """Return a diagnosis as terminal and page have it.

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
        Section("notes", "What was understood of the logs", [result.notes], open=False),
        _origin(verdict, origin),
        _read(verdict),
    )
    return Document(
        title=f"modelgap: {robot}",
        about=Markup("modelgap diagnosis of <b>{}</b>").format(robot),
        headline=first,
        lead=[" ".join(lead)] if lead else (),
        tiles=tiles_of(result),
        callouts=[Callout("Warnings", [*weak, *verdict.warnings])],
        sections=sections,
    )


def tiles_of(result: Diagnosis) -> tuple[Tile | None, ...]:
    """Return up to four figures that say what is missing, and what naming it gains."""
    return _size(result), _fall(result), _sure(result), _rest(result)


def _size(result: Diagnosis) -> Tile | None:
    """The size of one finding; of several, how many there are."""
    named = result.effects
    if len(named) == 1:
        name, value = tables.size_of(named[0], result.verdict)
        of = f"of {tables.title(named[0], result.verdict)}"
        return Tile(sentence_case(name), value, of) if name else None
    confirmed = sum(one.evidence.held_out == "confirmed" for one in named)
    note = f"{confirmed} of them confirmed on unseen motion"
    return Tile("Effects found", str(len(named)), note) if named else None


def _fall(result: Diagnosis) -> Tile | None:
    label = "Error on unseen motion"
    change = words.change(result.verdict) if result.effects else None
    if change:
        fall = f"{change.before:.1f} → {percent(change.after)}"
        where = change.where.removesuffix(",")
        return Tile(label, fall, f"of the torque {where}, before → after")
    level, where = words.level(result.errors)
    note = f"of the torque {where.removesuffix(',')}, refitted"
    return None if result.effects else Tile(label, percent(level), note)


def _sure(result: Diagnosis) -> Tile | None:
    named = result.effects
    if not named:
        return None
    if len(named) == 1:
        (one,) = named
        other = f", or {tables.others(one, result)}" if one.equivalent else ""
        note = f"that it is {noun(one.name)}{other}; "
        note += held_out_words(one.evidence.held_out)
        return Tile("How sure", sure(one.probability), note)
    likely = [one.probability for one in named if known(one.probability)]
    weakest = sure(min(likely, default=None))
    return Tile("How sure", weakest, "of the least certain name, against all others")


def _rest(result: Diagnosis) -> Tile | None:
    left = result.unexplained
    if not known(left.fraction):
        return None
    note = "of the torque"
    if known(left.noise_floor):
        note += f"; noise alone is {fraction(left.noise_floor)}"
    return Tile("Still unexplained", fraction(left.fraction), note)


def _folded(figures: Sequence[Chart], title: str, grid: bool = True) -> Fold | None:
    """More figures, which open at a click; in a grid where they are small."""
    shown = f"{title} ({many(len(figures), 'figure')})"
    return Fold(shown, [figures] if grid else figures) if figures else None


def truth(staged: Staged) -> list[Part]:
    """Return what was hidden beside what was found."""
    title = "The seal, opened after the verdict was stored"
    return [
        words_table(("", "hidden", "found"), staged.rows, title),
        Note(staged.judged, "callout"),
        *([Note(staged.forms)] if staged.forms else []),
    ]


def _staged(staged: Staged | None) -> Section:
    parts: list[Part] = []
    if staged:
        alt = "The simulated arm moves through a part of one experiment"
        gif = [Chart(staged.uri, alt, staged.caption)] if staged.gif else []
        parts = [Beside((gif, truth(staged)))]
    return Section("staged", "The experiment, and what was hidden", parts)


def _missing(result: Diagnosis, figures: Sequence[Sequence[Chart]]) -> Section:
    parts: list[Part] = []
    for at, own in enumerate(figures):
        parts += _finding(result, at, own)
    note = _TEXT["clouds"] if any(figures) else ""
    brief = [
        *tables.findings_table(result),
        *(outlook.other_sets(result.verdict) if result.effects else ()),
        *baseline_sentences(result.verdict),
    ]
    return Section("missing", "What is missing", parts, note, brief=brief)


def _finding(result: Diagnosis, at: int, figures: Sequence[Chart]) -> list[Part]:
    """One finding: what it does, its size, and what was measured of it."""
    effect, verdict = result.effects[at], result.verdict
    title = sentence_case(tables.title(effect, verdict))
    sentence = sentence_case("".join(result.sentences[at : at + 1]).strip())
    sentence += "." if sentence and sentence[-1] not in ".!?" else ""
    text: list[Part | None] = [sentence, tables.means(result, effect)]
    if effect.equivalent:
        text.append(Note(_cannot_tell(effect, result), "callout"))
    if effect.parameters or effect.combinations:
        frame = tables.frame_words(effect, verdict.frames)
        text.append(tables.parameter_table(effect, verdict))
        text.append(Note(f"Vectors are {frame}.") if frame else None)
    heading = Heading(f"{effect.order}. {title}")
    if len(figures) == 1:
        return [heading, Beside((text, figures))]
    shown = _OPEN if at == 0 else 0
    more = "The other joints" if shown else "What it explains, joint by joint"
    return [heading, *text, figures[:shown], _folded(figures[shown:], more)]


def _cannot_tell(effect: Finding, result: Diagnosis) -> Markup:
    return Markup(
        "<b>These data cannot tell {} from {}.</b> How sure the name is goes for all "
        "of these together; only another motion can tell which one it is."
    ).format(noun(effect.name), tables.others(effect, result, " or from "))


def _proof(result: Diagnosis, bars: Chart | None) -> Section:
    lines, worse = tables.error_rows(result), "; ".join(rising(result.verdict))
    worse = worse and f"Worse with the findings by more than 2 % (moving): {worse}."
    about = "Held-out error, % of the measured torque"
    table = tables.error_table(lines, tables.METRICS, about)
    few = len(result.effects) < _MANY
    parts: list[Part | None] = [
        bars,
        Fold("The errors of each joint", [table], few) if table else None,
    ]
    parts += [Note(worse, "callout")] if worse and any(parts) else []
    after = _TEXT["after" if result.effects else "no_after"]
    note = _TEXT["stages"].format(after) if bars else ""
    heading = "Before and after, on unseen motion"
    brief = [tables.brief_errors(result, lines), worse]
    return Section("proof", heading, parts, note, brief=brief)


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
        rest = "The other joints" if first else "All joints"
        parts += [Heading(title), *figures[:first]]
        parts.append(_folded(figures[first:], rest, False))
    few = len(result.effects) < _MANY - 1
    return Section("curves", "Measured and predicted torque", parts, note, open=few)


def _else(result: Diagnosis) -> Section:
    parts: list[Part | None] = [outlook.other_sets(result.verdict)]
    plan, brief = outlook.next_words(result.verdict), []
    if plan:
        none = "No other set of effects explains these logs as well."
        parts += [none if result.effects and not parts[0] else None]
        parts += [Heading("The next experiment"), [*map(sentence_case, plan)]]
        brief = [Heading("Next experiment:"), *(f"  {line}" for line in plan)]
    heading = "What else it could be, and what would settle it"
    return Section("else", heading, parts, brief=brief)


def _evidence(result: Diagnosis) -> Section:
    parts: list[Part] = [tables.evidence_table(result)] if result.effects else []
    edits = baseline_sentences(result.verdict)
    if parts and edits:
        parts += [Heading("The edit test"), Note(_TEXT["edits"]), edits]
    few = len(result.effects) < _MANY
    return Section("evidence", "How sure that is", parts, open=few)


def _given(verdict: Verdict) -> Section:
    off, most = outlook.off(verdict), outlook.MOST_VALUES
    heads = ("Value", "As given", "As the logs have it", "Off by")

    def table(changes: Sequence[Change], title: str = "") -> Table:
        return words_table(heads, outlook.value_rows(changes, verdict), title)

    title = f"All {len(verdict.changes)} values, as given and as these logs have them"
    folded = Fold(title, [table(verdict.changes)])
    if not off:
        parts = [_TEXT["none_off"], folded] if verdict.changes else ()
        return Section("given", "The values that the model was given", parts)
    heading, more = "Given values that the logs do not bear out", len(off) - most
    rest = f"And {more} more: 'changes' in the JSON has all of them." * (more > 0)
    parts = [table(off[:most]), Note(rest, "soft spaced") if rest else None, folded]
    brief = [table(off[:most], heading), rest]
    return Section("given", heading, parts, _TEXT["given"], brief=brief)


def _left(verdict: Verdict, figures: Sequence[Chart]) -> Section:
    text = " ".join(outlook.unexplained_words(verdict))
    about = Note(_TEXT["left"], "soft spaced") if figures else None
    brief = [f"\n{text}" if text else ""]
    parts = [text, about, figures] if text else ()
    return Section("left", "What stays unexplained", parts, brief=brief)


def _sizes(verdict: Verdict) -> Section:
    heads, rows = outlook.detectable_rows(verdict)
    heading, nothing = "What would have been found", not verdict.effects
    if not rows:
        return Section("sizes", heading, ())
    never = _NEVER if any(outlook.NEVER in row for row in rows) else ""
    # The longest word of a name, so that none is broken.
    least = max(len(word) for row in rows for word in row[0].split())
    title = "Smallest size that would have been found"
    look = {"least": {0: least}, "look": "tight sizes"}
    table = Table(heads, rows, title, left=(0, 1), **look)
    parts = [table, Note(never, "soft spaced") if never else None]
    brief = [table, never] if nothing else ()
    return Section("sizes", heading, parts, _TEXT["sizes"], open=nothing, brief=brief)


def _origin(verdict: Verdict, origin: Pairs) -> Section:
    """Under which assumptions, on which logs, and by what it was made."""
    declared, logs = ", ".join(verdict.declared), ", ".join(verdict.error.logs)
    note = f"Declared in the model: {declared or 'rigid body only'}."
    note += f" Held out: {logs}." if logs else ""
    if known(verdict.nominal_scale):
        scale = f"{100 * verdict.nominal_scale:.3g} %"
        note += f" Assumed spread of the nominal parameters: {scale}."
    facts = Facts(origin) if origin else None
    heading = "Where this page comes from"
    return Section("origin", heading, [Note(note), facts], open=False)


def _read(verdict: Verdict) -> Section:
    """What the words of the page mean; what it does not have is left out."""
    cutoff = number(verdict.error.cutoff_hz)
    at = "" if cutoff == MISSING else f" at {cutoff} Hz"
    terms = {word: text.format(cutoff=at) for word, text in texts()["reading"].items()}
    below = "All words: docs/glossary.md."
    return Section("read", "How to read this page", [terms], below=below, open=False)


def print_truth(staged: Staged, console: Console) -> None:
    """Print what was hidden beside what was found."""
    show(console, *truth(staged), wrapped=True)
