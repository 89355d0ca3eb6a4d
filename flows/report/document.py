"""What reports are made of: sentences, tables, charts, and figures at the head.

Each subject (a diagnosis, a calibration, a watched run) is told in these, a function a
section. `console.show` prints them in the terminal, the templates draw them on a page.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple


class Strong(str):
    """A cell that stands out; of several lines the first one does."""


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
    """

    heads: Sequence[str]
    rows: Sequence[Sequence[str]]
    title: str = ""
    left: Collection[int] = (0,)
    least: Mapping[int, int] = field(default_factory=dict)
    most: Mapping[int, int] = field(default_factory=dict)
    sections: Collection[int] = ()


def words_table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    """Return a table all of whose columns are words."""
    return Table(heads, rows, left=range(len(heads)))


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


# Sentences, a table, a chart, charts side by side, a list, words and what they mean.
Part = str | Table | Chart | Sequence[Chart] | Sequence[str] | Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Section:
    """A part of a page; one without parts is left out.

    Attributes:
        id: What links to it say.
        note: How it is meant, in small letters below the heading.
        below: More of that, at its end.
    """

    id: str
    heading: str
    parts: Sequence[Part]
    note: str = ""
    below: str = ""


@dataclass(frozen=True, slots=True)
class Document:
    """A page: the answer first, then its sections.

    Attributes:
        title: In the title of the window.
        about: What it is of, above the headline.
        lead: Sentences after the headline.
        setting: What it was made of and how.
        warned: Heading of the warnings.
    """

    title: str
    about: str
    headline: str
    sections: Sequence[Section]
    lead: Sequence[str] = ()
    tiles: Sequence[Tile] = ()
    setting: str = ""
    warnings: Sequence[str] = ()
    warned: str = "Warnings"
