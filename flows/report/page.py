"""A page: where its record comes from, templates, filters, the figures at its head.

Every page fills the blocks title, style, header, main and footer of base.html; the
list of contents is made of the headings ``<h2 id="...">`` of its main part.
"""

import base64
import hashlib
import json
import re
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from flows.report.document import Chart, Document, Strong, Table
from flows.report.words.phrases import sentence_case
from flows.requests import Diagnose
from residual import quantity
from residual.errors import InputError
from warehouse.files import read_parquet
from warehouse.layout import find
from warehouse.provenance import version_text

# Where a record and a page about it come from, and what makes them again.

_SHORT = 12  # digits of a commit that people read


@dataclass(frozen=True, slots=True)
class Made:
    """Where a record comes from.

    Attributes:
        what: Its kind in the singular, such as "diagnosis".
        id: Its id.
        created: When it was committed, ISO 8601 to the second, UTC.
        version: Version of the program that made it; None where it was not noted.
        commit: Commit in git of that program, its beginning; None for no checkout.
        changed: Whether the program had changes that were not committed.
        data: Ids that it was made from by role, such as fit, held_out and model.
        command: What makes it again and compares it.
    """

    what: str
    id: str
    created: str
    version: str | None
    commit: str | None
    changed: bool
    data: Mapping[str, tuple[str, ...]]
    command: str


_KINDS = {
    "runs": "run",
    "models": "model",
    "diagnoses": "diagnosis",
    "validations": "validation",
    "reports": "report",
    "adoptions": "adoption",
}


def made_of(store: Path, id: str) -> Made:
    """Return where a record of a store comes from.

    Raises:
        InputError: If there is no such record, or it is damaged.
    """
    found = find(store, id)
    is_run = found.kind == "runs"
    columns = ["created", "lineage", "manifest" if is_run else "provenance"]
    row = read_parquet(found.row, columns).to_pylist()[0]
    known = json.loads(row[columns[-1]])
    known = (known.get("provenance") if is_run else known) or {}
    data: dict[str, tuple[str, ...]] = {}
    for parent in row["lineage"] or ():
        role = parent["role"].replace("_", " ")
        data[role] = (*data.get(role, ()), parent["parent"])
    again = "show" if found.kind in ("reports", "adoptions") else "rerun"
    return Made(
        what=_KINDS[found.kind],
        id=found.id,
        created=f"{row['created']:%Y-%m-%d %H:%M:%S}",
        version=(known.get("versions") or {}).get("modelgap"),
        commit=(known.get("commit") or "")[:_SHORT] or None,
        changed=bool(known.get("dirty")),
        data=data,
        command=f"modelgap {again} {found.id}",
    )


Fact = tuple[str, tuple[str, ...]]


@dataclass(frozen=True, slots=True)
class Origin:
    """Where a page comes from.

    Attributes:
        facts: What it is, and its values: ids and names of files.
        program: Version and commit of the program.
        command: What makes the page again; empty where nothing does.
    """

    facts: tuple[Fact, ...]
    program: str
    command: str


def of_request(request: Diagnose, page: str = "report.html") -> Origin:
    """Return the origin of a diagnosis that was just made."""
    facts: list[Fact] = [("Robot", (request.robot,)), ("Logs", request.logs)]
    facts += [("Baseline", request.baseline)] if request.baseline else []
    facts += [("Held out", request.held_out)] if request.held_out else []
    model = request.model or "as the robot is described"
    facts.append(("Nominal model", (model,)))
    return Origin(tuple(facts), version_text(), command(request, page))


def of_record(made: Made, record: Mapping) -> Origin:
    """Return the origin of a diagnosis in the store."""
    facts: list[Fact] = [
        ("Diagnosis", (made.id,)),
        ("Stored", (f"{made.created} UTC",)),
    ]
    facts += [(role.capitalize(), ids) for role, ids in made.data.items()]
    program = " ".join(["modelgap", made.version or ""]).strip()
    if made.commit:
        program += f", commit {made.commit}"
        program += " with changes that were not committed" if made.changed else ""
    asked = record.get("request")
    again = made.command
    if asked:
        again = command(Diagnose.from_record(asked, None), "report.html")
    return Origin(tuple(facts), program, again)


def command(request: Diagnose, page: str) -> str:
    """Return the command line of a diagnosis with its page."""
    words = ["modelgap", "diagnose", *request.logs, "--robot", request.robot]
    for option, values in (
        ("--holdout", request.held_out),
        ("--baseline", request.baseline),
        ("--known", request.known),
    ):
        words += [word for value in values for word in (option, value)]
    if request.declared is not None:
        words += ["--declared", ",".join(request.declared) or "none"]
    for option, value in (
        ("--map", request.columns),
        ("--null", request.null),
        ("--model", request.model),
        ("--store", request.store),
    ):
        words += [option, str(value)] if value else []
    words += ["--trust-log"] if request.trust_log else []
    return shlex.join([*words, "--report", page])


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
