"""The page of a record without a report: what it holds, and what it was made from."""

from pathlib import Path

from flows.report.document import Document, Facts, ReportTable, Section
from flows.report.page import read_record_origin, render_html
from flows.report.phrases import capitalize_first
from flows.report.records import format_record_lines
from residual.quantity import MISSING
from warehouse.query.store import open_store
from warehouse.store_catalogue import find_record, read_record

_ERRORS = """
    SELECT stage, metric, coalesce(joint::VARCHAR, 'all') AS joint, value
    FROM errors WHERE source_id = $id ORDER BY metric, stage, errors.joint
"""
_PARAMETERS = """
    SELECT name, coalesce(joint::VARCHAR, '') AS joint, value, std, nominal, unit,
           status
    FROM parameters WHERE model_id = $id ORDER BY parameters.joint, name
"""


def render_record_page(store: Path, id: str) -> str:
    """Return the page of a record of any kind.

    Raises:
        InputError: If there is no such record, or it is damaged.
    """
    record, held = find_record(store, id), read_record(store, id)
    with open_store(store) as opened:
        tables = {
            heading: opened.sql(query, {"id": record.id}).to_pylist()
            for heading, query in (("Parameters", _PARAMETERS), ("Errors", _ERRORS))
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
