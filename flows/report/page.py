"""A page: the origin of its record, its template and scripts."""

import base64
import hashlib
import json
import re
from collections.abc import Sequence
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from flows.report import BoldText, Document, Pairs, html_tag
from flows.report.phrases import capitalize_first
from flows.requests import Diagnose, format_command
from warehouse.code_provenance import format_version
from warehouse.store_catalogue import find_record, read_record
from warehouse.store_files import read_parquet

_AGAIN = "Command"
_NOUNS = {"diagnoses": "diagnosis"}
_SHORT = 12  # digits of a commit that people read
_TEMPLATES = Path(__file__).parent / "templates"
_HEADING = re.compile(r'<h2 id="([^"]+)">(.*?)</h2>', re.DOTALL)


def _ids(ids: Sequence[str]) -> Markup:
    return Markup(" ").join(html_tag("code", id) for id in ids)


def read_record_origin(store: Path, id: str) -> Pairs:
    """Return the origin of a record of a store, for the foot of a page.

    Its kind and id, time and program, the ids of its inputs by role, and the command
    that makes it again.
    """
    record = find_record(store, id)
    is_run = record.kind == "runs"
    columns = ["created", "lineage", "manifest" if is_run else "provenance"]
    row = read_parquet(record.row, columns).to_pylist()[0]
    source = json.loads(row[columns[-1]])
    source = (source.get("provenance") if is_run else source) or {}
    program = (source.get("versions") or {}).get("modelgap") or "unknown version"
    if source.get("commit"):
        program += f", commit {source['commit'][:_SHORT]}"
        program += " with uncommitted changes" if source.get("dirty") else ""
    data: dict[str, list[str]] = {}
    for parent in row["lineage"] or ():
        data.setdefault(parent["role"].replace("_", " "), []).append(parent["parent"])
    kinds = record.kind, read_record(store, record.id).get("kind")
    again = "show" if {"reports", "adoptions", "tracking"} & {*kinds} else "rerun"
    return [
        (_NOUNS.get(record.kind, record.kind[:-1]).capitalize(), html_tag("code", record.id)),
        ("Stored", f"{row['created']:%Y-%m-%d %H:%M:%S} UTC"),
        ("Program", f"modelgap {program}"),
        *((capitalize_first(role), _ids(ids)) for role, ids in data.items()),
        (_AGAIN, html_tag("kbd", f"modelgap {again} {record.id}")),
    ]


def describe_request_origin(request: Diagnose, page: str = "report.html") -> Pairs:
    """Return the origin of a diagnosis that is not stored."""
    inputs = {
        "Robot": (request.robot,),
        "Logs": request.logs,
        "Baseline": request.baseline,
        "Held out": request.held_out,
        "Nominal model": (request.model or "robot description",),
        "Program": (format_version(),),
    }
    facts = [(name, _ids(values)) for name, values in inputs.items() if values]
    again = format_command(request, "--report", page)
    return [*facts, (_AGAIN, html_tag("kbd", again))]


def read_diagnosis_origin(store: Path, id: str) -> Pairs:
    """Return the origin of a diagnosis in the store, with the page made again."""
    facts, request = (read_record_origin(store, id), read_record(store, id).get("request"))
    if not request:
        return facts
    request = Diagnose.from_record(request, None)
    again = format_command(request, "--report", "report.html")
    return [*facts[:-1], (_AGAIN, html_tag("kbd", again))]


@cache
def read_plotly_script() -> str:
    """Return the script of the plotting library, as its package has it."""
    # Found and not imported: only its file is needed, and importing it takes longer.
    (folder,) = find_spec("plotly").submodule_search_locations
    path = Path(folder, "package_data", "plotly.min.js")
    return path.read_text(encoding="utf-8").strip()


@cache
def read_page_script(name: str) -> str:
    """Return one of our scripts: page.js draws figures, filter.js filters a table."""
    return (_TEMPLATES / name).read_text(encoding="utf-8").strip()


def list_page_scripts(body: str) -> list[str]:
    """Return the scripts that a page runs; none where nothing on it needs one."""
    drawn = [read_plotly_script(), read_page_script("page.js")] if 'class="plot"' in body else []
    return [*drawn, *([read_page_script("filter.js")] if "data-filters=" in body else [])]


@cache
def hash_script(script: str) -> str:
    """Return a script as a content policy names it (CSP level 3, section 2.3.1)."""
    code = hashlib.sha256(script.encode()).digest()
    return f"'sha256-{base64.b64encode(code).decode()}'"


def embed_json(value: object) -> Markup:
    """Return a value as JSON that may stand within a script element."""
    text = json.dumps(value, separators=(",", ":"), ensure_ascii=False)
    # None of these can end the element or begin a comment in it.
    for sign in "<>&\u2028\u2029":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return Markup(text)


@cache
def _environment() -> Environment:
    # Everything is escaped: names of logs and columns come from other people's files.
    templates = Environment(
        loader=FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    templates.filters |= {
        "as_data": embed_json,
        "headings": lambda body: [
            (id, Markup(t).striptags()) for id, t in _HEADING.findall(str(body))
        ],
        "kind": lambda part: type(part).__name__,
        "script_hash": hash_script,
        "scripts": list_page_scripts,
    }
    templates.tests["strong"] = lambda cell: isinstance(cell, BoldText)
    return templates


def render_html(page: Document) -> str:
    """Return a document as one HTML page that needs nothing else."""
    return _environment().get_template("document.html").render(page=page)
