"""What all pages share: templates, filters, the figures at their heads.

Every page fills the blocks title, style, header, main and footer of base.html; the
list of contents is made of the headings ``<h2 id="...">`` of its main part.
"""

import re
from functools import cache
from pathlib import Path
from typing import NamedTuple

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from flows.report.page import script
from flows.report.words.phrases import sentence_case
from residual import quantity

_TEMPLATES = Path(__file__).parent / "templates"
_HEADING = re.compile(r'<h2 id="([^"]+)">(.*?)</h2>', re.DOTALL)


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
        "number": quantity.number,
        "sentence": sentence_case,
        "headings": headings,
        "as_data": script.as_data,
        "script_hash": script.hash_of,
    }
    found.globals |= {
        "library": script.library,
        "own_script": script.own,
        "script_hashes": script.hashes,
    }
    found.tests["known"] = quantity.known
    return found


def headings(body: str) -> list[tuple[str, Markup]]:
    """Return id and text of each section of a page, in order."""
    return [(id, Markup(text).striptags()) for id, text in _HEADING.findall(str(body))]
