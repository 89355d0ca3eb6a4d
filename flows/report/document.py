"""The parts that reports are made of: sentences, tables, charts, figures at the head.

Each subject (a diagnosis, a calibration) is a function a section. `console` prints the
parts in the terminal, `page` renders them. Any text may be `Markup`: a page takes it as
it is, the terminal without its tags.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import accumulate
from typing import Any, NamedTuple

from markupsafe import Markup


class Strong(str):
    """A bold line or cell; of several lines the first one is bold."""


def tag(name: str, text: object, look: str = "") -> Markup:
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
        groups: Titles over neighboring columns, and how many columns each has.
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


def words_table(
    heads: Sequence[str], rows: Sequence[Sequence[str]], title: str = ""
) -> ReportTable:
    """Return a table all of whose columns are words."""
    return ReportTable(heads, rows, title, text_columns=range(len(heads)))


class Tile(NamedTuple):
    """One figure at the head of a page: its label, its value, its meaning."""

    label: str
    value: str
    note: str


@dataclass(frozen=True, eq=False, slots=True)
class Chart:
    """A figure with its text.

    Attributes:
        uri: The picture as a data address; empty where the page draws it.
        alt: What it shows, for readers who do not see it.
        caption: One or two sentences below it.
        joint: Joint it shows, None where it shows all.
        name: Effect it shows, None where it shows none.
        plot: Its data and layout, as plotly's schema has them.
        height: Of a drawn figure [CSS px].
    """

    uri: str
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

    pairs: Sequence[tuple[str, str]]


@dataclass(frozen=True, slots=True)
class Fold:
    """Parts that a page opens at a click."""

    title: str
    parts: Sequence["Part"]
    open: bool = False


@dataclass(frozen=True, slots=True)
class Beside:
    """Columns of parts, side by side where there is room."""

    columns: Sequence[Sequence["Part"]]


# Also a list, charts side by side, terms and their definitions.
Part = (str | ReportTable | Chart | Note | Heading | Facts | Fold | Beside) | (
    Sequence[Chart] | Sequence[str] | Mapping[str, str]
)


@dataclass(frozen=True, slots=True)
class Section:
    """A part of a page; empty parts are left out, and a section without parts.

    Attributes:
        id: Fragment of links to it.
        note: Small print below the heading.
        open: Whether it is unfolded at first; None for what cannot be folded.
        brief: What the terminal prints of it.
    """

    id: str
    heading: str
    parts: Sequence[Part | None]
    note: str = ""
    open: bool | None = None
    brief: Sequence[str | ReportTable | Heading | None] = ()


@dataclass(frozen=True, slots=True)
class Document:
    """A page: the answer first, then its sections.

    Attributes:
        title: Title of the window.
        about: Its subject, above the headline.
        lead: Sentences after the headline.
        warnings: Lines before the sections.
        foot: Its origin.
    """

    title: str
    about: str
    headline: str
    sections: Sequence[Section]
    lead: Sequence[str] = ()
    tiles: Sequence[Tile | None] = ()
    warnings: Sequence[str] = ()
    foot: Sequence[tuple[str, str]] = ()
