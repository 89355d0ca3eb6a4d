"""One figure of a page with its text."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, eq=False, slots=True)
class Chart:
    """A figure with its text.

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
    caption: str
    joint: int | None = None
    name: str | None = None
    plot: Mapping[str, Any] | None = None
    height: int = 0
