"""A diagnosis in the terminal and on a page: the verdict first, then what is behind.

Each section is a function; what the terminal has of it is its ``brief``.
"""

from collections.abc import Iterable, Sequence

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
from flows.report.page import Pairs, fragment
from flows.report.page import render as render_page
from flows.report.tables import sure
from flows.report.words import outlook
from flows.report.words import verdict as words
from flows.report.words.phrases import (
    Staged,
    baseline_sentences,
    joint_words,
    many,
    noun,
    sentence_case,
    texts,
)
from flows.report.words.verdict import held_out_words, rising
from residual.diagnosis.result import Diagnosis, Finding, Verdict
from residual.quantity import MISSING, fraction, known, number, percent, probability

_TEXT = texts()["diagnosis"]

_MANY = 3  # findings from which tables and curves are folded
_OPEN = 3  # figures of the first finding that are not
_NEVER = f"{outlook.NEVER}: not detectable here; no arm has so much."


def render(
    found: Diagnosis,
    robot_name: str,
    staged: Staged | None = None,
    motion: Chart | None = None,
    origin: Pairs = (),
) -> str:
    """Return the report page.

    Args:
        motion: Picture of the motion that is proposed.
        origin: Where it comes from, and what makes the page again.

    Returns:
        One self-contained HTML document; the same diagnosis gives the same bytes.
    """
    return render_page(document(found, robot_name, staged, motion, origin))


def print_diagnosis(found: Diagnosis, console: Console, verbose: bool = False) -> None:
    """Print a diagnosis: verdict, findings, errors, what is left, what to do next.

    Args:
        console: Where to print; 80 columns and no colour are enough.
        verbose: List the effects that these logs could not tell apart.
    """
    told = document(found, drawn=False)
    first = ("missing", "given", "proof", "left", "sizes")
    print_document(console, told, first, ("else",))
    if verbose and not found.effects:
        pairs = outlook.confusable_pairs(found.verdict)
        show(console, *(f"  look alike: {pair}" for pair in pairs), wrapped=True)
    line(console, "")


def document(
    found: Diagnosis,
    robot: str = "",
    staged: Staged | None = None,
    motion: Chart | None = None,
    origin: Pairs = (),
    drawn: bool = True,
) -> Document:
    """Return a diagnosis as terminal and page have it.

    Args:
        drawn: Whether it has its figures, which no terminal needs.
    """
    verdict = found.verdict
    first, *lead = words.sentences(verdict)
    weak = [_TEXT["weak"]] if verdict.error.same_run and drawn else []
    sections = (
        _staged(staged),
        _missing(found, charts.finding_charts(found) if drawn else ()),
        _proof(found, charts.error_charts(found) if drawn else ()),
        _curves(found, *(charts.motions(found) if drawn else ((), 0))),
        _else(found, motion),
        _evidence(found),
        _given(verdict),
        _left(verdict, charts.left_charts(found) if drawn else ()),
        _sizes(verdict),
        _spectra(verdict, *(charts.spectrum_charts(found) if drawn else ((), ()))),
        Section(
            "notes", "What was understood of the logs", _listed(found.notes), open=False
        ),
        _origin(verdict, origin),
        _read(verdict),
    )
    return Document(
        title=f"modelgap: {robot}",
        about=Markup("modelgap diagnosis of <b>{}</b>").format(robot),
        headline=first,
        lead=[" ".join(lead)] if lead else (),
        tiles=tiles_of(found),
        callouts=[Callout("Warnings", [*weak, *verdict.warnings])],
        sections=sections,
    )


def tiles_of(found: Diagnosis) -> list[Tile]:
    """Return up to five figures that say what is missing, and what naming it gains."""
    return [
        *(_one_size(found) if len(found.effects) == 1 else _count(found.effects)),
        *_torque(found),
        *_fall(found),
        *_sure(found),
        *_unexplained(found),
    ]


def _one_size(found: Diagnosis) -> list[Tile]:
    effect = found.effects[0]
    name, value = tables.size_of(effect, found.verdict)
    of = f"of {tables.title(effect, found.verdict)}"
    return [Tile(sentence_case(name), value, of)] if name else []


def _count(named: Sequence[Finding]) -> list[Tile]:
    if not named:
        return []
    confirmed = sum(one.evidence.held_out == "confirmed" for one in named)
    note = f"{confirmed} of them confirmed on unseen motion"
    return [Tile("Effects found", str(len(named)), note)]


def _torque(found: Diagnosis) -> list[Tile]:
    """What the robot's controller does not know: the most that a model lacks."""
    named = found.effects
    lacking = [(m, one) for one in named for m in tables.missing_torque(found, one)]
    if not lacking:
        return []
    most, effect = max(lacking, key=lambda pair: pair[0].share or 0.0)
    note = joint_words([most.joint])
    if most.share:
        note += f": {fraction(most.share)} of the largest torque there"
    if len(named) > 1:
        note += f", from {noun(effect.name)}"
    return [Tile("Torque that the model lacks", f"up to {number(most.peak)} N m", note)]


def _fall(found: Diagnosis) -> list[Tile]:
    label = "Error on unseen motion"
    change = words.change(found.verdict) if found.effects else None
    if change:
        fall = f"{change.before:.1f} → {percent(change.after)}"
        where = change.where.removesuffix(",")
        return [Tile(label, fall, f"of the torque {where}, before → after")]
    if found.effects:
        return []
    level, where = words.level(found.errors)
    return [Tile(label, percent(level), f"of the torque {where}, refitted")]


def _sure(found: Diagnosis) -> list[Tile]:
    named = found.effects
    if not named:
        return []
    if len(named) == 1:
        (one,) = named
        other = f", or {tables.others(one, found)}" if one.equivalent else ""
        note = f"that it is {noun(one.name)}{other}; "
        note += held_out_words(one.evidence.held_out)
        return [Tile("How sure", sure(one.probability), note)]
    likely = [one.probability for one in named if known(one.probability)]
    weakest = sure(min(likely, default=None))
    return [Tile("How sure", weakest, "of the least certain name, against all others")]


def _unexplained(found: Diagnosis) -> list[Tile]:
    left = found.unexplained
    if not known(left.fraction):
        return []
    note = "of the torque"
    if known(left.noise_floor):
        note += f"; noise alone is {fraction(left.noise_floor)}"
    return [Tile("Still unexplained", fraction(left.fraction), note)]


def _folded(figures: Sequence[Chart], title: str, grid: bool = True) -> list[Fold]:
    """More figures, which open at a click; in a grid where they are small."""
    shown = f"{title} ({many(len(figures), 'figure')})"
    return [Fold(shown, [figures] if grid else figures)] if figures else []


def _listed(lines: Sequence[str]) -> list[Sequence[str]]:
    return [lines] if lines else []


def truth(staged: Staged) -> list[Part]:
    """Return what was hidden beside what was found."""
    title = "The seal, opened after the verdict was stored"
    return [
        words_table(("", "hidden", "found"), staged.rows, title),
        Note(staged.judged, "callout"),
        *staged.edits,
        *([Note(staged.forms)] if staged.forms else []),
    ]


def _staged(staged: Staged | None) -> Section:
    parts: list[Part] = []
    if staged:
        alt = "The simulated arm moves through a part of one experiment"
        gif = [Chart(staged.uri, alt, staged.caption)] if staged.gif else []
        parts = [Beside((gif, truth(staged)))]
    return Section("staged", "The experiment, and what was hidden", parts)


def _missing(found: Diagnosis, figures: Sequence[Sequence[Chart]]) -> Section:
    parts: list[Part] = []
    for at, own in enumerate(figures):
        parts += _finding(found, at, own)
    note = _TEXT["clouds"] if any(figures) else ""
    brief = [
        *tables.findings_table(found),
        *(outlook.other_sets(found.verdict) if found.effects else ()),
        *baseline_sentences(found.verdict),
    ]
    return Section("missing", "What is missing", parts, note, brief=brief)


def _finding(found: Diagnosis, at: int, figures: Sequence[Chart]) -> list[Part]:
    """One finding: what it does, its size, and what was measured of it."""
    effect, verdict = found.effects[at], found.verdict
    title = sentence_case(tables.title(effect, verdict))
    text: list[Part] = [*_said(found, at)]
    if effect.equivalent:
        text.append(Note(_cannot_tell(effect, found), "callout"))
    if effect.parameters or effect.combinations:
        text.append(tables.parameter_table(effect, verdict))
        frame = tables.frame_words(effect, verdict.frames)
        text += [Note(f"Vectors are {frame}.")] if frame else []
    heading = Heading(f"{effect.order}. {title}")
    if len(figures) == 1:
        return [heading, Beside((text, figures))]
    shown = _OPEN if at == 0 else 0
    more = "The other joints" if shown else "What it explains, joint by joint"
    seen = _listed(figures[:shown])
    return [heading, *text, *seen, *_folded(figures[shown:], more)]


def _said(found: Diagnosis, at: int) -> Iterable[str]:
    """What a finding is and what a model without it gets wrong."""
    said = sentence_case("".join(found.sentences[at : at + 1]).strip())
    said += "." if said and said[-1] not in ".!?" else ""
    return filter(None, (said, tables.means(found, found.effects[at])))


def _cannot_tell(effect: Finding, found: Diagnosis) -> Markup:
    return Markup(
        "<b>These data cannot tell {} from {}.</b> How sure the name is goes for all "
        "of these together; only another motion can tell which one it is."
    ).format(noun(effect.name), tables.others(effect, found, " or from "))


def _proof(found: Diagnosis, bars: Sequence[Chart]) -> Section:
    parts: list[Part] = []
    if bars:
        after = (
            _TEXT["after"]
            if found.effects
            else "Nothing was added, so there is no after."
        )
        parts = [Note(_TEXT["stages"].format(after)), bars[0]]
        parts += _folded(bars[1:], "The same over all samples, standstill too", False)
    lines = tables.error_rows(found)
    table = tables.error_table(lines)
    few = len(found.effects) < _MANY
    parts += [Fold("The errors of each joint", [table], few)] if table else []
    worse = _worse(found.verdict)
    if parts and worse:
        parts.append(Note(worse, "callout"))
    brief = [*tables.brief_errors(found, lines), *([worse] if worse else [])]
    heading = "Before and after, on unseen motion"
    return Section("proof", heading, parts, brief=brief)


def _worse(verdict: Verdict) -> str:
    worse = "; ".join(rising(verdict))
    return f"Worse with the findings by more than 2 % (moving): {worse}." * bool(worse)


def _curves(
    found: Diagnosis, motions: Sequence[tuple[str, list[Chart]]], undrawn: int
) -> Section:
    note, parts = _TEXT["curves"], []
    if undrawn:
        many = len(motions)
        note += f" The {many} held-out logs with the largest error are drawn; the table"
        note += f" above is of all {many + undrawn}."
    for at, (label, figures) in enumerate(motions, 1):
        many = f" {at}" if len(motions) > 1 else ""
        title = Markup("Held-out motion{} {}").format(many, tag("code", label))
        first = 1 if at == 1 else 0
        rest = "The other joints" if first else "All joints"
        parts += [Heading(title), *figures[:first]]
        parts += _folded(figures[first:], rest, False)
    few = len(found.effects) < _MANY - 1
    return Section("curves", "Measured and predicted torque", parts, note, open=few)


def _else(found: Diagnosis, motion: Chart | None) -> Section:
    sets, plan = outlook.other_sets(found.verdict), outlook.next_words(found.verdict)
    none = "No other set of effects explains these logs as well."
    parts: list[Part] = _listed(sets)
    if plan:
        parts += [none] if found.effects and not sets else []
        parts += [Heading("The next experiment"), [*map(sentence_case, plan)]]
        parts += [motion] if motion else []
    brief = [Heading("Next experiment:"), *(f"  {line}" for line in plan)]
    heading = "What else it could be, and what would settle it"
    return Section("else", heading, parts, brief=brief if plan else ())


def _evidence(found: Diagnosis) -> Section:
    heading, named = "How sure that is", found.effects
    if not named:
        return Section("evidence", heading, ())
    parts: list[Part] = [tables.evidence_table(found)]
    edits = baseline_sentences(found.verdict)
    if edits:
        parts += [Heading("The edit test"), Note(_TEXT["edits"]), edits]
    return Section("evidence", heading, parts, open=len(named) < _MANY)


def _given(verdict: Verdict) -> Section:
    off, every = outlook.off_rows(verdict), outlook.all_rows(verdict)
    more = outlook.hidden_rows(verdict)
    heading = "Given values that the logs do not bear out"
    parts: list[Part] = [
        "None of them is off beyond chance and by more than 5 %, other than what is "
        "named above."
    ]
    if off:
        parts = [Note(_TEXT["given"]), _values(off)]
        rest = f"And {more} more, in the list of all values."
        parts += [Note(rest, "soft spaced")] if more else []
    title = f"All {len(every)} values, as given and as these logs have them"
    parts = [*parts, Fold(title, [_values(every)])] if every else []
    shown = heading if off else "The values that the model was given"
    heads = ("value", "as given", "as the logs have it", "")
    rest = [f"and {more} more: 'changes' in the JSON has all of them."] if more else []
    brief = [words_table(heads, off, heading), *rest] if off else ()
    return Section("given", shown, parts, brief=brief)


def _values(rows: Sequence[tuple[str, ...]]) -> Table:
    heads = ("Value", "As given", "As the logs have it", "Off by")
    return Table(heads, [(sentence_case(what), *rest) for what, *rest in rows])


def _left(verdict: Verdict, figures: Sequence[Chart]) -> Section:
    said = " ".join(outlook.unexplained_words(verdict))
    parts = [said, *([Note(_TEXT["left"], "soft spaced"), figures] if figures else [])]
    heading = "What stays unexplained"
    brief = [f"\n{said}"]
    return Section("left", heading, parts if said else (), brief=brief if said else ())


def _sizes(verdict: Verdict) -> Section:
    heads, rows = outlook.detectable_rows(verdict)
    heading, nothing = "What would have been found", not verdict.effects
    if not rows:
        return Section("sizes", heading, ())
    never = any(outlook.NEVER in row for row in rows)
    told = [(sentence_case(name), *rest) for name, *rest in rows]
    parts: list[Part] = [Table(heads, told, left=(0, 1), look="tight sizes")]
    parts += [Note(_NEVER, "soft spaced")] if never else []
    alike = outlook.confusable_words(verdict)
    pairs = outlook.confusable_pairs(verdict)
    parts += [Fold(alike, [pairs])] if alike else []
    heads, rows = outlook.detectable_rows(verdict, short=True)
    # The longest word of a name, so that none is broken.
    least = max(len(word) for row in rows for word in row[0].split())
    title = "Smallest size that would have been found"
    brief = [Table(heads, rows, title, left=(0, 1), least={0: least})]
    brief += [*([_NEVER] if never else [])]
    brief += [f"{alike} --verbose lists them."] if alike else []
    brief = brief if nothing else ()
    return Section("sizes", heading, parts, _TEXT["sizes"], open=nothing, brief=brief)


def _spectra(
    verdict: Verdict, first: Sequence[Chart], others: Sequence[Chart]
) -> Section:
    cutoff = number(verdict.error.cutoff_hz)
    note = (
        "How much the models leave at each frequency, on all held-out motion together "
        "(Welch's method). "
    )
    if cutoff != MISSING:
        note += f"Both sides are low-passed at {cutoff} Hz, so beyond that nothing is "
        note += "left to see. "
    note += "A line that stays at one frequency points to something that turns or "
    note += "swings."
    parts = [first, *_folded(others, "The other joints")] if first else ()
    return Section("spectra", "Spectrum of the residual", parts, note, open=False)


def _origin(verdict: Verdict, origin: Pairs) -> Section:
    """Under which assumptions, on which logs, and by what it was made."""
    declared = ", ".join(verdict.declared)
    said = [f"Declared in the model: {declared or 'rigid body only'}."]
    if verdict.error.logs:
        said.append(f"Held out: {', '.join(verdict.error.logs)}.")
    if known(verdict.nominal_scale):
        scale = f"{100 * verdict.nominal_scale:.3g} %"
        said.append(f"Assumed spread of the nominal parameters: {scale}.")
    parts = [Note(" ".join(said)), *([Facts(origin)] if origin else [])]
    return Section("origin", "Where this page comes from", parts, open=False)


def _read(verdict: Verdict) -> Section:
    """What the words of the page mean; what it does not have is left out."""
    cutoff = number(verdict.error.cutoff_hz)
    at = "" if cutoff == MISSING else f" at {cutoff} Hz"
    terms = {word: text.format(cutoff=at) for word, text in texts()["reading"].items()}
    if not any(known(effect.evidence.p_value) for effect in verdict.effects):
        del terms["p"]
    return Section("read", "How to read this page", [terms], open=False)


def print_truth(staged: Staged, console: Console) -> None:
    """Print what was hidden beside what was found."""
    show(console, *truth(staged), wrapped=True)


def summary(found: Diagnosis) -> str:
    """Return the headline, the effects, and the errors before and after, escaped."""
    errors, dof = found.errors, found.verdict.dof
    parts: list[Part] = [tag("strong", words.sentences(found.verdict)[0])]
    if found.effects:
        heads = ("missing", "size", "probability", "cannot be told from")
        rows = [
            (
                one.where,
                "; ".join(f"{key} {value}" for key, value in one.parameters.items()),
                probability(one.probability),
                ", ".join(other.name for other in one.equivalent) or MISSING,
            )
            for one in found.effects
        ]
        parts.append(words_table(heads, rows))
    parts.append(f"Error on held-out motion ({', '.join(errors.logs)}), filtered:")
    rows = [
        (name, *map(percent, values), percent(errors.overall_moving.get(name)))
        for name, values in errors.moving.items()
        if values is not None
    ]
    heads = ("model", *(f"joint {j}" for j in range(1, dof + 1)), "all")
    parts += [Table(heads, rows), *(f"Warning: {w}" for w in found.warnings)]
    return fragment(parts)
