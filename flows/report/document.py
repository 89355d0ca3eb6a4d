"""What reports are made of: sentences, tables, charts, and figures at the head.

Each subject (a diagnosis, a calibration) is told in these, a function a
section. `console` prints them in the terminal, `page` draws them. Any text may be
`Markup`: a page takes it as it is, the terminal without its tags.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from itertools import accumulate
from typing import Any, NamedTuple

from markupsafe import Markup


class Strong(str):
    """A cell that stands out; of several lines the first one does."""


def tag(name: str, text: object, look: str = "") -> Markup:
    """Return text within a tag of a page, such as kbd for what is typed."""
    start = Markup('<{} class="{}">').format(name, look) if look else f"<{name}>"
    return Markup("{}{}</{}>").format(Markup(start), text, name)


def link(address: str, text: object) -> Markup:
    """Return text that leads to an address."""
    return Markup('<a href="{}">{}</a>').format(address, text)


def when(time: datetime) -> Markup:
    """Return a time to the minute, never broken."""
    return tag("time", f"{time:%Y-%m-%d %H:%M}")


@dataclass(frozen=True, slots=True)
class Table:
    """A table of text.

    Attributes:
        heads: Titles of the columns; may be of several lines.
        rows: Cells as text; may be of several lines.
        title: Above it; empty for none.
        left: Columns of words, from 0; all others are numbers, on the right.
        least: Columns that may not get narrower, and their width in characters.
        most: Columns that break their words at a width, and it.
        sections: Rows, from 0, before which a new part of it begins.
        groups: Words over columns that belong together, and how many those are.
        named: Column that says what a row is of.
        filters: Columns by whose values a reader may narrow it.
        look: Its class in the style sheet.
    """

    heads: Sequence[str]
    rows: Sequence[Sequence[str]]
    title: str = ""
    left: Collection[int] = (0,)
    least: Mapping[int, int] = field(default_factory=dict)
    most: Mapping[int, int] = field(default_factory=dict)
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
) -> Table:
    """Return a table all of whose columns are words."""
    return Table(heads, rows, title, left=range(len(heads)))


class Tile(NamedTuple):
    """One figure at the head of a page: what it is, its value, what it means."""

    label: str
    value: str
    note: str


@dataclass(frozen=True, eq=False, slots=True)
class Chart:
    """A picture with its text.

    Attributes:
        uri: The picture as a data address; empty where the page draws it.
        alt: What it shows, for readers who do not see it.
        caption: One or two sentences below it.
        joint: Joint it shows, None where it shows all.
        name: Effect it shows, None where it shows none.
        plot: What the page draws it from, as plotly's schema has it.
        height: Of what the page draws [CSS px].
    """

    uri: str
    alt: str
    caption: str = ""
    joint: int | None = None
    name: str | None = None
    plot: Mapping[str, Any] | None = None
    height: int = 0


@dataclass(frozen=True, slots=True)
class Note:
    """A sentence that looks otherwise: soft, callout, command, or as a page says."""

    text: str
    look: str = "soft"


@dataclass(frozen=True, slots=True)
class Heading:
    """What the parts after it are of, within a section."""

    text: str


@dataclass(frozen=True, slots=True)
class Callout:
    """Lines that are to be seen before all else, such as warnings."""

    heading: str
    lines: Sequence[str]
    warn: bool = True


@dataclass(frozen=True, slots=True)
class Facts:
    """What something is of or from: words and values."""

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


# Also a list, charts side by side, words and what they mean.
Part = (str | Table | Chart | Note | Heading | Callout | Facts | Fold | Beside) | (
    Sequence[Chart] | Sequence[str] | Mapping[str, str]
)


@dataclass(frozen=True, slots=True)
class Section:
    """A part of a page; what is None or empty is left out, and one without parts.

    Attributes:
        id: What links to it say.
        note: How it is meant, in small letters below the heading.
        below: More of that, at its end.
        open: Whether it is unfolded at first; None for what cannot be folded.
        shown: Whether its heading is seen, and not only read out.
        brief: What the terminal has of it.
    """

    id: str
    heading: str
    parts: Sequence[Part | None]
    note: str = ""
    below: str = ""
    open: bool | None = None
    shown: bool = True
    brief: Sequence[str | Table | Heading | None] = ()


@dataclass(frozen=True, slots=True)
class Document:
    """A page: the answer first, then its sections.

    Attributes:
        title: In the title of the window.
        about: What it is of, above the headline.
        lead: Sentences after the headline.
        setting: What it was made of and how.
        callouts: What is to be seen before the sections.
        foot: Where it is from.
    """

    title: str
    about: str
    headline: str
    sections: Sequence[Section]
    lead: Sequence[str] = ()
    tiles: Sequence[Tile | None] = ()
    setting: str = ""
    callouts: Sequence[Callout] = ()
    foot: Sequence[tuple[str, str]] = ()
