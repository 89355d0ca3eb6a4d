"""modelgap runs, show, verify, quarantine: what the store remembers."""

import json
import sys
from collections.abc import Iterable
from typing import Literal

from flows.report.answers import check_shown, print_table, tell_damage
from flows.requests import Format, Number, Store, Text
from flows.settings import store_folder
from residual.errors import InputError
from warehouse.layout import find, read_record
from warehouse.quarantine import quarantine as set_aside
from warehouse.quarantine import tombstone
from warehouse.query import store as opening
from warehouse.query.views import text as quoted
from warehouse.runs import read_manifest

_COLUMNS = (
    "run_id, robot, log, tags, kind, trajectory, duration_s, created, quarantined"
)


def runs(
    limit: Number = 50,
    format: Format = "table",
    store: Store = None,
) -> None:
    """List the runs of the store, the latest last.

    ```
    modelgap runs
    modelgap runs --limit 1000 --format csv
    ```

    Args:
        limit: How many of the latest to list.
        format: How to print them.
    """
    if limit < 1:
        raise InputError(f"--limit {limit}: expected 1 or more.")
    check_shown(format, None)
    with opening.open_store(store_folder(store)) as opened:
        latest = f"FROM runs ORDER BY created DESC, run_id LIMIT {limit}"
        query = f"SELECT {_COLUMNS} FROM ({latest}) ORDER BY created, run_id"
        rows = opened.sql(query, without_damaged=True)
        print_table(rows, format)
        tell_damage(opened)
        _tell_rows(opened, rows.column("run_id").to_pylist())


def verify(*, store: Store = None) -> None:
    """Read the whole store and say what is not as it was written.

    ```
    modelgap verify
    ```

    Every byte of every record, seal and robot is held against its SHA-256, every id
    against what it is the hash of. Exit code 1 where something is damaged or missing,
    so that it can run by itself, from cron for example. Nothing is changed. It takes
    about as long as reading the store from the disk.
    """
    from flows.steps import diff as steps

    for line in steps.verify(store_folder(store)):
        print(line, flush=True)


def quarantine(id: str, /, *, reason: Text, store: Store = None) -> None:
    """Say that a run should not be used, and why; nothing of it is changed.

    ```
    modelgap quarantine 3f2a --reason "the gripper was loose"
    ```

    SQL has the run with quarantined = true, monitor refuses it, and the inbox leaves it
    out; by its id it is read as before. The first reason stays. No command takes it
    back: the mark is the file quarantine/run_id=ID.json of the store, and without that
    file the run is as good as before.

    Args:
        id: Id of the run; the beginning is enough.
        reason: Why, for those who find it later.
    """
    with opening.open_store(store_folder(store)) as opened:
        found = find(opened.path, id).id
        known = tombstone(opened.path, found)
        set_aside(opened.path, found, reason)
    text = (
        f"was in quarantine already: {known}" if known else f"in quarantine: {reason}"
    )
    print(f"{found} {text}")


def show(
    id: str,
    /,
    *,
    format: Literal["text", "json"] = "text",
    store: Store = None,
) -> None:
    """Show all that is known of one run, model, diagnosis, validation or report.

    ```
    modelgap show 3f2a
    ```

    Args:
        id: Its id; the beginning is enough.
        format: How to print it.
    """
    with opening.open_store(store_folder(store)) as opened:
        found = find(opened.path, id)
        record = {
            "kind": found.kind,
            "id": found.id,
            "folder": str(found.folder.relative_to(opened.path)),
            **_relatives(opened, found.id),
            "quarantined": tombstone(opened.path, found.id),
            "content": read_record(opened.path, found.id),
        }
        tell_damage(opened)
    if format == "json":
        print(json.dumps(record, indent=2, ensure_ascii=False))
    else:
        from flows.report.records import record_lines

        print("\n".join(record_lines(record)))


def _tell_rows(store: opening.Store, ids: Iterable[str]) -> None:
    """Say whose record has gone or is damaged: the list has them from a copy."""
    for id in ids:
        try:
            read_manifest(store.path, id)
        except InputError as error:
            print(f"modelgap: listed from a copy: {error}", file=sys.stderr)


def _relatives(store: Store, id: str) -> dict:
    asked = {
        "parents": f"SELECT parent, role FROM lineage WHERE child = {quoted(id)}",
        "children": f"SELECT child, role FROM lineage WHERE parent = {quoted(id)}",
    }
    return {
        name: store.sql(query, without_damaged=True).to_pylist()
        for name, query in asked.items()
    }
