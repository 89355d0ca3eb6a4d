"""What runs, show and compact do; apart, since it loads the database."""

import json
import sys
from collections.abc import Mapping

import pyarrow as pa

from flows.report.terminal.answers import check_shown, print_table
from flows.settings import store_folder
from residual.errors import InputError
from warehouse.commit import read_record
from warehouse.layout import find
from warehouse.quarantine import tombstone
from warehouse.query.store import Store, open_store
from warehouse.query.views import text as quoted

_COLUMNS = (
    "run_id, robot, source, kind, trajectory, duration_s, rows, seed, created, "
    "quarantined"
)


def list_runs(option: str | None, limit: int, format: str) -> None:
    """Print the latest runs, the latest last."""
    if limit < 1:
        raise InputError(f"--limit {limit}: expected 1 or more.")
    check_shown(format, None)
    with open_store(store_folder(option)) as store:
        latest = f"FROM runs ORDER BY created DESC, run_id LIMIT {limit}"
        query = f"SELECT {_COLUMNS} FROM ({latest}) ORDER BY created, run_id"
        _print(store, store.sql(query), format)


def compact_runs(option: str | None, largest: float) -> None:
    """Copy the samples of small runs into packs, and say so."""
    if not 0 < largest < float("inf"):
        raise InputError(f"--largest {largest}: expected megabytes above 0.")
    with open_store(store_folder(option)) as store:
        done = store.compact(int(1e6 * largest))
        tell_damage(store)
    print(
        f"{done.runs} runs copied into {done.files} files of {done.size / 1e6:.1f} MB; "
        f"{done.left} larger or damaged ones are read as they are"
    )


def show_record(option: str | None, id: str, format: str) -> None:
    """Print one record: where it is, its relatives, and its content."""
    with open_store(store_folder(option)) as store:
        found = find(store.path, id)
        record = {
            "kind": found.kind,
            "id": found.id,
            "folder": str(found.folder.relative_to(store.path)),
            **_relatives(store, found.id),
            "quarantined": tombstone(store.path, found.id),
            "content": read_record(store.path, found.id),
        }
        tell_damage(store)
    if format == "json":
        print(json.dumps(record, indent=2, ensure_ascii=False))
        return
    for line in _lines(record):
        print(line)


def _relatives(store: Store, id: str) -> dict:
    parents = store.sql(f"SELECT parent, role FROM lineage WHERE child = {quoted(id)}")
    children = store.sql(f"SELECT child, role FROM lineage WHERE parent = {quoted(id)}")
    return {"parents": parents.to_pylist(), "children": children.to_pylist()}


def _print(store: Store, rows: pa.Table, format: str) -> None:
    print_table(rows, format)
    tell_damage(store)


def tell_damage(store: Store) -> None:
    """Say on standard error which files cannot be read."""
    for line in store.damaged:
        print(f"modelgap: left out: {line}", file=sys.stderr)


def _lines(value: Mapping | list, indent: str = "") -> list[str]:
    """Return a nested record as lines: key, then value or what is below it."""
    lines = []
    for key, item in _items(value):
        if _short(item):
            lines.append(f"{indent}{key}: {_word(item)}")
        else:
            lines += [f"{indent}{key}:", *_lines(item, indent + "  ")]
    return lines


def _items(value: Mapping | list) -> list[tuple]:
    if isinstance(value, Mapping):
        return list(value.items())
    return [("-", item) for item in value]


def _short(item: object) -> bool:
    """Whether a value fits on the line of its key."""
    if isinstance(item, Mapping):
        return not item
    if isinstance(item, list):
        return not any(isinstance(part, Mapping | list) and part for part in item)
    return True


def _word(item: object) -> str:
    if isinstance(item, list):
        return ", ".join(_word(part) for part in item) or "–"
    return "–" if item is None or item == {} else str(item)
