"""The page of one record: what it says, what it is from, what was made from it."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from flows.report.made import Made, made_of
from flows.report.night.look import ask
from flows.report.night.place import Place
from flows.report.terminal.records import record_lines
from residual.errors import InputError
from residual.names import shortened
from warehouse.commit import read_record
from warehouse.layout import find
from warehouse.query.store import Store
from warehouse.runs import tombstone
from warehouse.verify import other_files

_LINES = 150  # of what it says; the whole is `modelgap show`
_MOST = 60  # relatives that are listed

_PARENTS = "SELECT parent AS id, role FROM lineage WHERE child = $id ORDER BY role, id"
_CHILDREN = "SELECT child AS id, role FROM lineage WHERE parent = $id ORDER BY role, id"
_ERRORS = """
    SELECT stage, metric, joint, value FROM errors
    WHERE source_id = $id AND run_id IS NULL ORDER BY metric, stage, joint
"""


def context(opened: Store, id: str, place: Place) -> dict:
    """Return what the template `record.html` is filled with.

    Raises:
        InputError: If there is no such record, or it is damaged.
    """
    made = made_of(opened.path, id)
    content = read_record(opened.path, made.id)
    lines = record_lines(content)
    return {
        "title": f"modelgap: {made.what} {made.id}",
        "made": made,
        "about": _about(content),
        "lines": [shortened(line) for line in lines[:_LINES]],
        "lines_left": len(lines) - _LINES,
        "errors": _table(ask(opened, _ERRORS, id=made.id)),
        "parents": _linked(ask(opened, _PARENTS, id=made.id), opened.path),
        "children": _linked(ask(opened, _CHILDREN, id=made.id), opened.path),
        "pages": _pages(opened.path, made, place),
        "quarantined": tombstone(opened.path, made.id) if made.what == "run" else None,
    }


def _pages(store: Path, made: Made, place: Place) -> list[str]:
    """Return the addresses of the pages that a report has."""
    if made.what != "report":
        return []
    names = other_files(find(store, made.id))
    return [
        place.report(made.id, made.id, name) for name in names if name.endswith(".html")
    ]


def _about(content: Mapping) -> list[tuple[str, str]]:
    """Return the plain values of a record that say what it is."""
    keys = ("robot", "serial", "kind", "stage", "verdict", "source", "seed", "note")
    told = [(key, content.get(key)) for key in keys]
    return [(key, shortened(v)) for key, v in told if isinstance(v, str | int)]


def _table(rows: Sequence[Mapping]) -> dict | None:
    """Return errors as a table: a row per metric and stage, a column per joint."""
    joints = sorted({row["joint"] for row in rows if row["joint"]})
    if not rows:
        return None
    cells: dict[tuple[str, str], dict] = {}
    for row in rows:
        cells.setdefault((row["metric"], row["stage"]), {})[row["joint"]] = row["value"]
    lines = [
        (*key, [values.get(joint) for joint in (*joints, None)])
        for key, values in cells.items()
    ]
    return {"joints": joints, "lines": lines}


def _linked(rows: Sequence[Mapping], store: Path) -> dict:
    """Return relatives, and which of them this store has."""
    shown = [(row["id"], row["role"], _is_here(store, row["id"])) for row in rows]
    return {"rows": shown[:_MOST], "left": len(shown) - _MOST}


def _is_here(store: Path, id: str) -> bool:
    try:
        return bool(find(store, id))
    except InputError:
        return False
