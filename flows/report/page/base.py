"""What all pages share: templates, filters, the figures at their heads."""

from functools import cache
from pathlib import Path
from typing import NamedTuple

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from flows.report.words.phrases import sentence_case
from residual import quantity

_TEMPLATES = Path(__file__).parent / "templates"


class Tile(NamedTuple):
    """One figure at the head of the page: what it is, its value, what it means."""

    label: str
    value: str
    note: str


@cache
def environment() -> Environment:
    """Return where templates are found and how they are filled in."""
    # Everything is escaped: names of logs and columns come from other people's files.
    found = Environment(
        loader=FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    found.filters |= {
        "percent": quantity.percent,
        "bare": quantity.bare_percent,
        "probability": quantity.probability,
        "sentence": sentence_case,
    }
    found.tests["known"] = quantity.known
    return found
