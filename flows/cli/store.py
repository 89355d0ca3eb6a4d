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
from warehouse.query import store as opening
from warehouse.query.views import text as quoted
from warehouse.runs import quarantine as set_aside
from warehouse.runs import read_manifest, tombstone

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
        limit: Number of runs.
        format: Format of the output.
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
    """Check every byte of the store.

    ```
    modelgap verify
    ```

    Compares every file of every record, seal and robot with its SHA-256, and every id
    with the hash of its content. Exit code 1 if something is damaged or missing.
    Changes nothing, and takes about as long as reading the store from the disk.
    """
    from flows.steps import diff as steps

    for line in steps.verify(store_folder(store)):
        print(line, flush=True)


def quarantine(id: str, /, *, reason: Text, store: Store = None) -> None:
    """Mark a run as unusable.

    ```
    modelgap quarantine 3f2a --reason "the gripper was loose"
    ```

    The run itself is not changed. In SQL it has quarantined = true, monitor refuses it,
    and the inbox ignores it; its id still reads it. To undo, delete the file
    quarantine/run_id=ID.json of the store.

    Args:
        id: Id of the run, or its beginning.
        reason: Reason, which is stored; the first one is kept.
    """
    with opening.open_store(store_folder(store)) as opened:
        run_id = find(opened.path, id).id
        reason_before = tombstone(opened.path, run_id)
        set_aside(opened.path, run_id, reason)
    text = (
        f"was in quarantine already: {reason_before}"
        if reason_before
        else f"in quarantine: {reason}"
    )
    print(f"{run_id} {text}")


def show(
    id: str,
    /,
    *,
    format: Literal["text", "json"] = "text",
    store: Store = None,
) -> None:
    """Show one run, model, diagnosis, validation or report.

    ```
    modelgap show 3f2a
    ```

    Args:
        id: Id of the record, or its beginning.
        format: Format of the output.
    """
    with opening.open_store(store_folder(store)) as opened:
        place = find(opened.path, id)
        record = {
            "kind": place.kind,
            "id": place.id,
            "folder": str(place.folder.relative_to(opened.path)),
            **_relatives(opened, place.id),
            "quarantined": tombstone(opened.path, place.id),
            "content": read_record(opened.path, place.id),
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
    queries = {
        "parents": f"SELECT parent, role FROM lineage WHERE child = {quoted(id)}",
        "children": f"SELECT child, role FROM lineage WHERE parent = {quoted(id)}",
    }
    return {
        name: store.sql(query, without_damaged=True).to_pylist()
        for name, query in queries.items()
    }
