"""The index of a store: every result by robot and night, and the pages it links to.

One page, `reports/index.html` of the store, written when a report is stored and when
the server of the store receives a request for it; a browser filters it.
"""

import json
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, date, datetime, timedelta
from functools import lru_cache
from pathlib import Path

from markupsafe import Markup
from pydantic import TypeAdapter

from flows.outputs import json_text, write_files
from flows.report import Document, Facts, HeadlineFigure, ReportTable, Section, html_tag
from flows.report.charts import render_diagnosis_page
from flows.report.page import read_diagnosis_origin, read_record_origin, render_html
from flows.report.phrases import HiddenEffect, capitalize_first, count_noun
from flows.report.records import format_record_lines
from flows.report.sentences import format_claim, format_error_change, list_wrong_values
from flows.storage import read_outcome, read_verdict, store_report
from residual.errors import InputError
from residual.quantity import MISSING
from residual.verdict.document import to_json
from residual.verdict.result import Finding
from warehouse.code_provenance import format_version
from warehouse.queries import Store, open_store
from warehouse.record_ids import ID_DIGITS
from warehouse.store_catalogue import find_record, read_record
from warehouse.store_files import verify_file
from warehouse.verification import list_extra_files

INDEX = "index.html"
STATES = {
    "effects": "something missing",
    "unknown": "unknown",
    "values": "values off",
    "none": "nothing missing",
}
MOST = 2000  # rows of each kind, the latest; all others are in SQL
_HALF_A_DAY = timedelta(hours=12)
_RECORD = re.compile(rf"record_id=(\w{{1,{ID_DIGITS}}})\.html")
_FILE = re.compile(rf"report_id=([0-9a-f]{{{ID_DIGITS}}})/([\w-][\w.-]{{0,60}})")
_HEADS = ("Time (UTC)", "Night", "Robot", "State", "Result", "Error on unseen motion")

_QUERIES = Path(__file__).parent / "templates" / "index.toml"
# A robot is its name and, where it has one, its serial number: two of a kind are two.
_ROBOT = "coalesce(nullif(concat_ws(' ', {0}.robot, {0}.serial), ''), '?')"
_SQL = {
    name: query.format_map({table: _ROBOT.format(table) for table in "dmvaur"})
    for name, query in tomllib.loads(_QUERIES.read_text(encoding="utf-8")).items()
}

# Time, robot, state, result, error.
Row = tuple[datetime, str, Markup | str, Markup | str, str]


def write_index(store: Path) -> Path:
    """Write the index of a store; return its file."""
    with open_store(store) as opened:
        text = render_html(build_index_document(opened))
    path = store / "reports" / INDEX
    path.parent.mkdir(parents=True, exist_ok=True)
    write_files({path: text})
    return path


def read_page(store: Path, address: str) -> bytes | None:
    """Return the index or a file of a report; None where there is none.

    Only an id of hex digits and a file name that a record of the store has become part
    of a path.

    Args:
        address: Address in a link of the index: "index.html", "report_id=.../..." or
            "record_id=....html", a page that is not on disk.
    """
    if address == INDEX:
        with open_store(store) as opened:
            return render_html(build_index_document(opened, served=True)).encode()
    if record_match := _RECORD.fullmatch(address):
        try:
            return render_record_page(store, record_match[1]).encode()
        except InputError:
            return None
    match = _FILE.fullmatch(address)
    try:
        record = find_record(store, match[1]) if match else None
        path = list_extra_files(record).get(match[2]) if record else None
        if path is None or record.kind != "reports":
            return None
        verify_file(path)
        return path.read_bytes()
    except InputError:
        return None


def build_index_document(opened: Store, served: bool = False) -> Document:
    """Return the index of a store; `served` pages are also links to other records."""
    rows = sorted(_rows(opened, served), key=lambda row: row[0], reverse=True)
    cells = [
        (html_tag("time", f"{row[0]:%Y-%m-%d %H:%M}"), f"{date_night(row[0])}", *row[1:])
        for row in rows
    ]
    waits = sum("waits" in str(row[2]) for row in rows)
    table = ReportTable(
        _HEADS, cells, text_columns=range(6), named=4, look="list", filters=(1, 2, 3)
    )
    none = Markup(
        "Nothing is stored yet. <kbd>modelgap demo</kbd> or <kbd>modelgap up</kbd> fills the store."
    )
    written = f"{datetime.now(UTC):%Y-%m-%d %H:%M:%S} UTC by modelgap {format_version()}"
    return Document(
        title="modelgap: reports",
        about=Markup("Store <b>{}</b>").format(opened.path.name),
        headline="Results by robot and night",
        tiles=[
            HeadlineFigure("Robots", str(len({row[1] for row in rows})), ""),
            HeadlineFigure(
                "Nights", str(len({date_night(row[0]) for row in rows})), "from noon to noon UTC"
            ),
            HeadlineFigure("Waiting", str(waits), "for your decision"),
        ],
        sections=(Section("all", "Reports", [table if cells else none]),),
        foot=[("Store", opened.path.name), ("Written", written)],
    )


def date_night(time: datetime) -> date:
    """Return the night that a time belongs to, from noon to noon, by its morning."""
    return (time + _HALF_A_DAY).date()


def title_diagnosis(store: Path, diagnosis: str) -> str:
    """Return robot and number of a diagnosis, as "irb140 #2"."""
    with open_store(store) as opened:
        rows = _ask(opened, f"SELECT * FROM ({_SQL['diagnoses']}) WHERE id = $id", id=diagnosis)
    return _title(rows[0])


def list_refused_logs(store: Path, since: datetime) -> list[dict]:
    """Return the logs that inboxes refused since a time, the latest first.

    Each has `robot`, `why` and `created` [UTC].
    """
    with open_store(store) as opened:
        rows = _ask(opened, _SQL["refused"])
    return [row for row in rows if row["created"] and row["created"] > since]


def _rows(opened: Store, served: bool) -> Iterator[Row]:
    diagnoses = _ask(opened, _SQL["diagnoses"])
    titles = {each["id"]: _title(each) for each in diagnoses}
    for each in diagnoses[:MOST]:
        state, words, error = _verdict(opened.path, each["id"])
        text = Markup("{}: {}").format(titles[each["id"]], words)
        if each["report_id"]:
            text = _report(each["report_id"], "report.html", text)
        word = html_tag("span", STATES.get(state, state), f"of {state}")
        yield each["created"], each["robot"], word, text, error
    for each in _ask(opened, _SQL["proposals"])[:MOST]:
        title = titles.get(each["id"], each["robot"])
        words = f"{title}: proposed and current model compared"
        text = _report(each["report_id"], "proposal.html", words)
        if each["waits"]:
            text += Markup(" ") + html_tag("kbd", f"modelgap adopt {each['id'][:8]}")
        state = "waits for a decision" if each["waits"] else "decided"
        yield each["created"], each["robot"], state, text, ""
    for each in _ask(opened, _SQL["alarms"])[:MOST]:
        alarms = ", ".join(sorted(each["what"]))
        words = f"in {count_noun(each['runs'], 'run')}: {alarms}"
        yield each["created"], each["robot"], "alarm", words, ""
    for each in _ask(opened, _SQL["refused"])[:MOST]:
        yield each["created"], each["robot"] or "?", "log refused", each["why"], ""
    for each in _ask(opened, _SQL["records"])[:MOST]:
        runs = each["runs"] or ()
        of = f"of run {runs[0][:8]}" if len(runs) == 1 else f"of {len(runs)} runs"
        words = each["words"] or f"{each['state']} {of if runs else each['id'][:8]}"
        text = _link(served, each["id"], words)
        yield each["created"], each["robot"], each["state"], text, ""
    for each in _ask(opened, _SQL["runs"])[:MOST]:
        motion = f": {each['trajectory']}" if each["trajectory"] else ""
        words = f"{count_noun(each['runs'], each['source'] + ' run')}{motion}"
        text = _link(served, each["id"], words) if each["runs"] == 1 else words
        yield each["created"], each["robot"], "runs", text, ""


def _ask(opened: Store, query: str, **values: object) -> list[dict]:
    """Return the rows of a query; damaged records are left out."""
    return opened.sql(query, values or None, without_damaged=True).to_pylist()


def _title(diagnosis: Mapping) -> str:
    return f"{diagnosis['robot']} #{diagnosis['number']}"


def _link(served: bool, id: str, words: str) -> Markup:
    """Return words that link to the page of a record; a file has its command."""
    if served:
        return Markup('<a href="record_id={}.html">{}</a>').format(id, words)
    return Markup("{} {}").format(words, html_tag("kbd", f"modelgap show {id[:8]}"))


def _report(id: str, file: str, words: str) -> Markup:
    return Markup('<a href="report_id={}/{}">{}</a>').format(id, file, words)


# A record never changes, and reading one takes longer than making a row of it.
@lru_cache(maxsize=2 * MOST)
def _verdict(store: Path, diagnosis: str) -> tuple[str, str, str]:
    """Return the state of a verdict, its findings and its errors, in words."""
    try:
        verdict = read_verdict(store, diagnosis)
    except InputError:
        return "unknown", "its record cannot be read", MISSING
    words, pair = format_claim(verdict).removesuffix("."), format_error_change(verdict)
    state = (
        "values" if verdict.verdict == "none" and list_wrong_values(verdict) else verdict.verdict
    )
    weak = " (end of the fitted run)" if pair and verdict.error.same_run else ""
    return state, words, f"{pair}{weak}"


def render_record_page(store: Path, id: str) -> str:
    """Return the page of a record of any kind."""
    record, held = find_record(store, id), read_record(store, id)
    with open_store(store) as opened:
        tables = {
            heading: opened.sql(query, {"id": record.id}).to_pylist()
            for heading, query in (("Parameters", _SQL["parameters"]), ("Errors", _SQL["errors"]))
        }
    facts = [(k, v) for k, v in held.items() if isinstance(v, str | int | float)]
    more = format_record_lines({k: v for k, v in held.items() if (k, v) not in facts})
    sections = [
        Section("facts", "Record", [Facts([(k, str(v)) for k, v in facts])]),
        *(
            Section(heading.lower(), heading, [_table(rows)])
            for heading, rows in tables.items()
            if rows
        ),
        Section("more", "Details", [more], open=False),
    ]
    kind = capitalize_first(record.kind.removesuffix("s"))
    return render_html(
        Document(
            title=f"{kind} {record.id[:8]}",
            about=str(held.get("robot") or store.name),
            headline=f"{kind} {record.id}",
            sections=sections,
            foot=read_record_origin(store, record.id),
        )
    )


def _table(rows: list[dict]) -> ReportTable:
    cells = [[_cell(value) for value in row.values()] for row in rows]
    words = [i for i, v in enumerate(rows[0].values()) if not isinstance(v, float)]
    return ReportTable(tuple(rows[0]), cells, text_columns=words)


def _cell(value: object) -> str:
    if value is None:
        return MISSING
    return f"{value:.5g}" if isinstance(value, float) else str(value)


_HIDDEN = TypeAdapter(tuple[HiddenEffect, ...])


def store_diagnosis_page(
    ids: Sequence[str],
    store: Path,
    kind: str,
    hidden: Sequence[HiddenEffect] | None = None,
    files: Mapping[str, bytes] | None = None,
) -> Path:
    """Write the page and the verdict of a diagnosis into the store; `kind` is "nightly", "demo"."""
    result = read_outcome(store, ids[1])
    robot = result.verdict.robot
    origin = read_diagnosis_origin(store, ids[0])
    records = describe_name_records(store, ids[0], result.effects)
    page = render_diagnosis_page(result, robot, hidden, origin, records)
    verdict = json_text(to_json(result.verdict)).encode()
    contents = {"report.html": page.encode(), "verdict.json": verdict, **(files or {})}
    folder = store_report(store, {"robot": robot, "kind": kind}, ids[0], contents)
    write_index(store)
    return folder / "report.html"


def store_demo_page(ids: Sequence[str], hidden: Sequence[Mapping], store: Path) -> Path:
    """Write the page of a demonstration, with the truth at its end."""
    files = {"truth.json": (json.dumps(list(hidden), indent=2) + "\n").encode()}
    return store_diagnosis_page(ids, store, "demo", parse_hidden_effects(hidden), files)


def parse_hidden_effects(records: Sequence[Mapping]) -> tuple[HiddenEffect, ...]:
    """Return the records of a seal as hidden effects."""
    return _HIDDEN.validate_python(records)


_NAMED_BEFORE = """
    WITH this AS (
        SELECT robot, any_value(serial) AS serial FROM verdicts
        WHERE diagnosis_id = $id GROUP BY robot
    )
    SELECT diagnosis_id,
           list_sort(list(DISTINCT run_id) FILTER (role = 'fit')) AS runs,
           list(DISTINCT {'name': effect, 'joints': joints})
               FILTER (effect IS NOT NULL) AS named
    FROM verdicts JOIN this USING (robot)
    WHERE verdicts.serial IS NOT DISTINCT FROM this.serial
    GROUP BY diagnosis_id ORDER BY min(verdicts.created), diagnosis_id
"""
_LAST = 20  # diagnoses of other runs that a record goes back


def describe_name_records(store: Path, id: str, effects: Sequence[Finding]) -> tuple[str, ...]:
    """Return for each finding of a diagnosis how often its arm's diagnoses had it.

    Counts diagnoses up to this one, of the same runs only the last.
    """
    with open_store(store) as opened:
        rows = opened.sql(_NAMED_BEFORE, {"id": id}).to_pylist()
    named_by_runs: dict[tuple, list] = {}
    for row in rows:
        runs = tuple(row["runs"] or (row["diagnosis_id"],))
        named_by_runs.pop(runs, None)
        named_by_runs[runs] = row["named"] or []
        if row["diagnosis_id"] == id:
            break
    last = list(named_by_runs.values())[-_LAST:]
    return tuple(_describe_record(effect, last) for effect in effects)


def _describe_record(effect: Finding, diagnoses: Sequence[Sequence[dict]]) -> str:
    if len(diagnoses) < 2:
        return "This is the first stored diagnosis of this arm; there is none to compare with."
    times = sum(
        any(
            named["name"] == effect.name
            and (not effect.joints or {*named["joints"]} & {*effect.joints})
            for named in each
        )
        for each in diagnoses
    )
    of = f"{len(diagnoses)} stored diagnoses of this arm, each of different runs"
    return f"Record: named in {times} of the last {of}."
