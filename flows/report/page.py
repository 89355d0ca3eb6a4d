"""What all pages share: templates, filters, the figures at their heads.

Every page fills the blocks title, style, header, main and footer of base.html; the
list of contents is made of the headings ``<h2 id="...">`` of its main part.
"""

import base64
import hashlib
import json
import re
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from flows.report.document import Chart, Document, Strong, Table
from flows.report.made import Made
from flows.report.words.phrases import sentence_case
from residual import quantity
from residual.errors import InputError

_OWN = Path(__file__).parent / "templates" / "page.js"


@cache
def library() -> str:
    """Return the script of the plotting library, as its package has it."""
    return _packaged("plotly", "package_data", "plotly.min.js")


@cache
def scene_library() -> str:
    """Return the script that draws in 3-D, as its package has it.

    Raises:
        InputError: If that package, an extra, is not installed.
    """
    if find_spec("meshcat") is None:
        raise InputError(
            "An arm in 3-D needs MeshCat, which is not installed. It comes with the "
            'extra: pip install "modelgap[view]".'
        )
    return _packaged("meshcat", "viewer", "dist", "main.min.js")


def of_template(name: str) -> str:
    """Return a script of ours that stands beside the templates."""
    return (_OWN.parent / name).read_text(encoding="utf-8").strip()


def _packaged(package: str, *parts: str) -> str:
    # Found and not imported: only its file is needed, and importing it takes longer.
    (folder,) = find_spec(package).submodule_search_locations
    return Path(folder, *parts).read_text(encoding="utf-8").strip()


@cache
def own() -> str:
    """Return our script, which draws what a page has the data of."""
    return _OWN.read_text(encoding="utf-8").strip()


@cache
def hashes() -> tuple[str, ...]:
    """Return the scripts as a content policy names them: 'sha256-...'."""
    return tuple(hash_of(text) for text in (library(), own()))


def hash_of(script: str) -> str:
    """Return a script as a content policy names it (CSP level 3, section 2.3.1)."""
    code = hashlib.sha256(script.encode()).digest()
    return f"'sha256-{base64.b64encode(code).decode()}'"


def as_data(value: object) -> Markup:
    """Return a value as JSON that may stand within a script element.

    Args:
        value: What JSON can hold; NaN becomes null.
    """
    text = json.dumps(value, separators=(",", ":"), ensure_ascii=False)
    # None of these can end the element or begin a comment in it.
    for sign in "<>&\u2028\u2029":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return Markup(text)


_TEMPLATES = Path(__file__).parent / "templates"
_HEADING = re.compile(r'<h2 id="([^"]+)">(.*?)</h2>', re.DOTALL)


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
        "as_data": as_data,
        "script_hash": hash_of,
    }
    found.globals |= {
        "library": library,
        "own_script": own,
        "script_hashes": hashes,
    }
    found.tests |= {
        "known": quantity.known,
        "strong": lambda cell: isinstance(cell, Strong),
        "table": lambda part: isinstance(part, Table),
        "chart": lambda part: isinstance(part, Chart),
    }
    return found


def render_document(page: Document, made: Made | None = None) -> str:
    """Return a document as one HTML page that needs nothing else.

    Args:
        made: Where its record comes from, for its foot; None where nothing is stored.
    """
    template = environment().get_template("document.html")
    return template.render(page=page, made=made)


def headings(body: str) -> list[tuple[str, Markup]]:
    """Return id and text of each section of a page, in order."""
    return [(id, Markup(text).striptags()) for id, text in _HEADING.findall(str(body))]
