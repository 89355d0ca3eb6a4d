"""The parts of reports (sentences, tables, charts), and how a terminal shows them."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import accumulate, chain
from typing import Any, NamedTuple

from markupsafe import Markup
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.padding import Padding
from rich.table import Table as RichTable
from rich.text import Text

from flows.outputs import print_plain
from residual.errors import strip_control_characters

Pairs = Sequence[tuple[str, str]]


class BoldText(str):
    """A bold line or cell; of several lines the first one is bold."""


def html_tag(name: str, text: object, look: str = "") -> Markup:
    """Return text within a tag of a page, such as kbd."""
    start = Markup('<{} class="{}">').format(name, look) if look else f"<{name}>"
    return Markup("{}{}</{}>").format(Markup(start), text, name)


@dataclass(frozen=True, slots=True)
class ReportTable:
    """A table of text.

    Attributes:
        heads: Titles of the columns; may be of several lines.
        rows: Cells as text; may be of several lines.
        title: Above it; empty for none.
        text_columns: Columns of words, from 0; all others are numbers, on the right.
        max_widths: Columns that wrap their words at a width [characters].
        sections: Rows, from 0, above which a line is drawn.
        groups: Titles over neighbouring columns, and how many columns each has.
        named: Column that names the row.
        filters: Columns that a reader may filter by.
        look: Its class in the style sheet.
    """

    heads: Sequence[str]
    rows: Sequence[Sequence[str]]
    title: str = ""
    text_columns: Collection[int] = (0,)
    max_widths: Mapping[int, int] = field(default_factory=dict)
    sections: Collection[int] = ()
    groups: Sequence[tuple[str, int]] = ()
    named: int = 0
    filters: Collection[int] = ()
    look: str = "tight"

    @property
    def starts(self) -> Collection[int]:
        """Columns at which a group begins."""
        return [*accumulate(columns for _, columns in self.groups)][:-1]


def build_text_table(
    heads: Sequence[str], rows: Sequence[Sequence[str]], title: str = ""
) -> ReportTable:
    """Return a table all of whose columns are words."""
    return ReportTable(heads, rows, title, text_columns=range(len(heads)))


def format_markdown_table(table: ReportTable, most: int | None = None) -> str:
    """Return a table as Markdown, for the pages of Prefect; at most so many rows."""
    rows = [table.heads, ["---"] * len(table.heads), *table.rows[:most]]
    return "\n".join("| " + " | ".join(" ".join(c.split()) for c in row) + " |" for row in rows)


class HeadlineFigure(NamedTuple):
    """One figure at the head of a page: its label, its value, its meaning."""

    label: str
    value: str
    note: str


@dataclass(frozen=True, eq=False, slots=True)
class Chart:
    """A figure with its text.

    Attributes:
        alt: What it shows, for readers who do not see it.
        caption: One or two sentences below it.
        joint: Joint it shows, None where it shows all.
        name: Effect it shows, None where it shows none.
        plot: Its data and layout, as plotly's schema has them.
        height: Of a drawn figure [CSS px].
    """

    alt: str
    caption: str = ""
    joint: int | None = None
    name: str | None = None
    plot: Mapping[str, Any] | None = None
    height: int = 290


@dataclass(frozen=True, slots=True)
class Note:
    """A sentence of another class of the style sheet: soft, callout."""

    text: str
    look: str = "soft"


@dataclass(frozen=True, slots=True)
class Heading:
    """A heading within a section."""

    text: str


@dataclass(frozen=True, slots=True)
class Facts:
    """Pairs of words and values."""

    pairs: Pairs


@dataclass(frozen=True, slots=True)
class FoldedParts:
    """Parts that a page opens at a click, and that a terminal may print."""

    title: str
    parts: Sequence["Part"]
    open: bool = False
    printed: bool = False


@dataclass(frozen=True, slots=True)
class SideBySide:
    """Columns of parts, side by side where there is room."""

    columns: Sequence[Sequence["Part"]]


# Also a list, charts side by side, terms and their definitions.
Part = (str | ReportTable | Chart | Note | Heading | Facts | FoldedParts | SideBySide) | (
    Sequence[Chart] | Sequence[str] | Mapping[str, str]
)


@dataclass(frozen=True, slots=True)
class Section:
    """A part of a page; empty parts are left out, and a section without parts.

    Attributes:
        id: Fragment of links to it.
        note: Small print below the heading.
        open: Whether it is unfolded at first; None for what cannot be folded.
        printed: Whether a terminal shows it too, without its figures.
    """

    id: str
    heading: str
    parts: Sequence[Part | None]
    note: str = ""
    open: bool | None = None
    printed: bool = True


@dataclass(frozen=True, slots=True)
class Document:
    """A page: the answer first, then its sections.

    Attributes:
        title: Title of the window.
        about: Its subject, above the headline.
        lead: Sentences after the headline.
        warnings: Lines before the sections.
        foot: Its origin.
        next_step: What to do next, in words, and the command for it.
    """

    title: str
    about: str
    headline: str
    sections: Sequence[Section]
    lead: Sequence[str] = ()
    tiles: Sequence[HeadlineFigure | None] = ()
    warnings: Sequence[str] = ()
    foot: Pairs = ()
    next_step: tuple[str, str] | None = None


# What a terminal without Unicode shows instead.
_PLAIN = str.maketrans({"→": ">", "±": "+", "–": "-", "²": "2", "³": "3", "·": ","})
_WIDE = 200
_NONE = ("", "–")


def print_parts(console: Console, *parts: Part | None, wrapped: bool = False) -> None:
    """Print sentences and tables in order, without figures.

    Args:
        wrapped: Break sentences at the width of the terminal; without it they stay on
            one line, so that paths and commands can be copied.
    """
    for part in _list_printable(parts):
        if isinstance(part, ReportTable):
            _print_table(console, part, edges=not (wrapped or part.title))
        elif isinstance(part, Heading):
            print_line(console, f"\n{part.text}", "bold")
        elif wrapped:
            print_line(console, part, "bold" if isinstance(part, BoldText) else "")
        else:
            print_plain(console, part)


def _list_printable(parts: Sequence[Part | None]) -> Iterator[str | ReportTable | Heading]:
    """Yield what a terminal shows of parts; sentences without the marks of a page."""
    for part in parts:
        if isinstance(part, ReportTable | Heading):
            yield part
        elif isinstance(part, Markup):
            yield part.striptags()
        elif isinstance(part, Note):
            yield from _list_printable([part.text])
        elif isinstance(part, str) and part:
            yield part
        elif isinstance(part, list | tuple):
            yield from _list_printable(part)
        elif isinstance(part, FoldedParts) and part.printed:
            yield from _list_printable(part.parts)
        elif isinstance(part, SideBySide):
            yield from chain.from_iterable(map(_list_printable, part.columns))


def print_document(console: Console, document: Document) -> None:
    """Print the headline of a document, its sections and its warnings."""
    print_line(console, "")
    print_line(console, " ".join([document.headline, *document.lead]), "bold")
    if document.next_step:
        print_plain(console, "Next: {}:\n  {}".format(*document.next_step))
    for section in document.sections:
        parts = [*_list_printable(section.parts)] if section.printed else []
        if parts:
            print_parts(console, Heading(section.heading), *parts, wrapped=True)
    for number, words in enumerate(document.warnings):
        print_line(console, f"{'' if number else chr(10)}Warning: {words}", "yellow")


def print_line(console: Console, text: str, style: str = "") -> None:
    """Print a sentence, wrapped at the width of the terminal, its indent kept."""
    words = _readable(console, Text(strip_control_characters(text), style=style))
    indent = len(words.plain) - len(words.plain.lstrip(" "))
    padded = Padding(words[indent:], (0, 0, 0, indent), expand=False)
    console.print(padded if indent else words)


def widen_piped_console(console: Console, width: int = _WIDE) -> Console:
    """Return a console that cuts nothing: into a file or a pipe as wide as it needs."""
    return console if console.is_terminal else Console(file=console.file, width=width)


def _print_table(console: Console, table: ReportTable, edges: bool) -> None:
    drawn = RichTable(box=SIMPLE_HEAD, show_edge=edges, pad_edge=False)
    for i, head in enumerate(table.heads):
        words = i in table.text_columns
        # Words wrap between words; numbers never.
        longest = max((len(w) for row in table.rows for w in row[i].split()), default=0)
        drawn.add_column(
            _readable(console, Text(head)),
            justify="left" if words else "right",
            no_wrap=not words,
            min_width=min(longest, console.width // 3) if words else None,
            max_width=table.max_widths.get(i),
            overflow="fold",
        )
    for number, row in enumerate(table.rows):
        if number in table.sections:
            drawn.add_section()
        drawn.add_row(*(_readable(console, _cell(cell)) for cell in row))
    if table.title:
        print_parts(console, Heading(table.title), wrapped=True)
    if drawn.__rich_measure__(console, console.options).minimum <= console.width:
        console.print(drawn)
        return
    heads = [" ".join(head.split()) for head in table.heads[1:]]
    for first, *cells in table.rows:  # too narrow for columns: a row at a time
        pairs = zip(heads, map(_cell, cells), strict=True)
        shown = [f"{head} {cell}" for head, cell in pairs if cell.plain not in _NONE]
        words = ", ".join(shown)
        print_parts(console, BoldText(first), f"  {words}", wrapped=True)


def _cell(text: str) -> Text:
    # As text, so that nothing in a name is taken for markup.
    words = text.striptags() if isinstance(text, Markup) else text
    cell = Text(strip_control_characters(words))
    if isinstance(text, BoldText):
        cell.stylize("bold", 0, len(text.split("\n")[0]))
    return cell


def _readable(console: Console, text: Text) -> Text:
    """Return the text in characters that the terminal has."""
    if "utf" in console.encoding.lower():
        return text
    ascii = text.plain.translate(_PLAIN).encode("ascii", "replace").decode()
    return Text(ascii, style=text.style)
