"""Putting records into the store: each visible whole or not at all, at any kill."""

import hashlib
import json
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pyarrow as pa

from residual.errors import InputError
from residual.names import check_keys, check_name
from residual.recording import Recording
from warehouse import ids
from warehouse.files import (
    publish,
    read_parquet,
    staged,
    sync,
    table_hash,
    to_table,
    write_parquet,
)
from warehouse.kinds import KINDS, SAMPLES_FILE
from warehouse.layout import find, record_folder
from warehouse.objects.mirror import bucket_of, is_copied
from warehouse.origin.made_with import keep_made_with
from warehouse.origin.provenance import Provenance, as_record, provenance
from warehouse.query.catalogue import remember
from warehouse.runs import Parents, about_run, lineage_rows
from warehouse.schema import SIGNALS
from warehouse.seal import Sealed, commit_seal, sealed_hash

Array = np.ndarray

_LOGGED = ("t", "q", "qd", "qdd", "tau", "q_ref")


def commit_run(
    store: Path,
    recording: Recording,
    manifest: Mapping,
    sealed: Sealed | None = None,
    extra: Mapping[str, Array] | None = None,
) -> str:
    """Put a run into the store; one of the same id that is there already stays.

    Args:
        manifest: How it came to be (keys: ``warehouse.runs``). With ``spec``, the
            open half, it is a simulated run; without, a measured one, which needs
            ``robot_hash``.

    Raises:
        InputError: If the manifest or a channel is not usable.
    """
    arrays = _channels(recording, extra or {})
    units = {name: SIGNALS[name].unit for name in arrays}
    # Written beside the hashing, on another core: together they take most of the time.
    # Of a run that is there already it is thrown away.
    flush = bucket_of(store) is None
    with staged(store, "run") as folder, ThreadPoolExecutor(1) as beside:
        writing = beside.submit(_write_samples, folder, arrays, units, flush)
        full = {
            **ids.plain(manifest),
            "provenance": as_record(provenance()),
            "data_hash": ids.data_hash(arrays),
            "sealed_sha256": sealed and sealed_hash(sealed.spec),
            "truth_hash": sealed and ids.data_hash(sealed.truth),
            "units": units,
        }
        id = _run_id(full)
        target = record_folder(store, "runs", id, recording.robot)
        if not _is_there(target, "runs"):
            row = _run_row(id, recording, full, arrays)
            keep_made_with(store)
            # The seal first: a run that is visible has its truth.
            if sealed:
                commit_seal(store, id, sealed)
            write_parquet(folder / KINDS["runs"].row, row)
            writing.result()
            if publish(folder, target):
                remember(store, KINDS["runs"], row)
    return id


def _write_samples(folder: Path, arrays: Mapping, units: Mapping, flush: bool) -> None:
    path = folder / SAMPLES_FILE
    write_parquet(path, to_table(arrays, units))
    if flush:
        sync(path)


def imported_run_id(recording: Recording, robot_hash: str) -> str:
    """Return the id that a measured recording has as a run, stored or not."""
    return ids.imported_id(ids.data_hash(_channels(recording, {})), robot_hash)


def commit_record(
    store: Path,
    kind: str,
    record: Mapping,
    tables: Mapping[str, pa.Table] | None = None,
    parents: Parents = (),
    files: Mapping[str, bytes] | None = None,
) -> str:
    """Put a model, diagnosis, validation or report into the store.

    Args:
        record: All there is to say, as JSON can hold it; what has the name of a column
            of the view becomes one.
        tables: ``errors`` and ``effects`` become rows of these views (columns as in
            ``schema.VIEWS``, without the record's own id); others become files.
        files: Other files by name, such as the page of a report.

    Returns:
        Its id: a hash of all of that, so the same record is kept once.

    Raises:
        InputError: If one of them is not usable.
    """
    if check_name(kind, KINDS, "kind of record") == "runs":
        raise InputError("Runs are committed by commit_run, other records here.")
    known, tables, files = KINDS[kind], dict(tables or {}), dict(files or {})
    record, lineage = ids.plain(record), lineage_rows(parents)
    sums = {name: table_hash(table) for name, table in tables.items()}
    sums |= {name: hashlib.sha256(data).hexdigest() for name, data in files.items()}
    id = ids.digest(kind, record, lineage, sums)[: ids.ID_DIGITS]
    target = record_folder(store, kind, id)
    if _is_there(target, kind):
        return id
    row = row_of(kind, id, provenance(), record) | {"lineage": lineage}
    for view in set(known.lists) - {"lineage"}:
        row[view] = tables.pop(view).to_pylist() if view in tables else []
    told = {"record": record, "provenance": as_record(provenance())}
    texts = {k: json.dumps(v, ensure_ascii=False) for k, v in told.items()}
    made = one_row(kind, row, texts)
    keep_made_with(store)
    with staged(store, id) as folder:
        for name, table in tables.items():
            write_parquet(folder / f"{_plain_name(name)}.parquet", table)
        for name, data in files.items():
            (folder / _plain_name(name)).write_bytes(data)
        write_parquet(folder / known.row, made)
        if publish(folder, target):
            remember(store, known, made)
    return id


def read_record(store: Path, id: str) -> dict:
    """Return what a record was committed with.

    Args:
        id: Id of a model, diagnosis, validation or report, or its beginning.

    Raises:
        InputError: If there is none, or it is damaged.
    """
    found = find(store, id)
    column = "manifest" if found.kind == "runs" else "record"
    return json.loads(read_parquet(found.row, [column]).column(column)[0].as_py())


def _channels(recording: Recording, extra: Mapping[str, Array]) -> dict[str, Array]:
    check_keys(extra, set(SIGNALS) - set(_LOGGED), "the extra channels of a run")
    logged = {name: getattr(recording, name) for name in _LOGGED}
    arrays = {k: v for k, v in {**logged, **extra}.items() if v is not None}
    for name, array in arrays.items():
        if name != "t" and np.shape(array) != recording.q.shape:
            raise InputError(
                f"{name} has shape {np.shape(array)}, expected {recording.q.shape}."
            )
    return arrays


def _run_id(full: Mapping) -> str:
    if full.get("spec") is not None:
        code_hash = full["provenance"]["code_hash"]
        return ids.run_id(full["spec"], full["sealed_sha256"], code_hash)
    if not full.get("robot_hash"):
        raise InputError(
            "A run needs 'spec' in its manifest, or 'robot_hash' where it was measured."
        )
    return ids.imported_id(full["data_hash"], full["robot_hash"])


def _is_there(target: Path, kind: str) -> bool:
    """Whether a record is at its place; a damaged one is told, not repaired."""
    if not is_copied(target):
        return False
    read_parquet(target / KINDS[kind].row, [KINDS[kind].key])
    return True


def _run_row(id: str, recording: Recording, full: Mapping, arrays: Mapping) -> pa.Table:
    about = about_run(full)
    row = row_of("runs", id, provenance(), about) | {
        "robot": recording.robot,
        "duration_s": recording.duration,
        "rows": len(recording.t),
        "dof": recording.dof,
        "data_hash": full["data_hash"],
        "signals": list(arrays),
        "lineage": lineage_rows(full.get("parents") or ()),
        "errors": _twin_errors(id, about["trajectory"], arrays),
    }
    extra = {
        "spec": ids.canonical(full.get("spec")).decode(),
        "sealed_sha256": full["sealed_sha256"],
        "manifest": json.dumps(full, ensure_ascii=False, allow_nan=False),
    }
    return one_row("runs", row, extra)


def _twin_errors(id: str, trajectory: str | None, arrays: Mapping) -> list[dict]:
    """Root mean square of each error against the twin, joint by joint."""
    same = {"run_id": id, "trajectory": trajectory, "stage": "twin"}
    return [
        {**same, "joint": joint, "metric": f"rms_{name}", "value": float(value)}
        for name, array in arrays.items()
        if name.startswith("e_")
        for joint, value in enumerate(np.sqrt(np.mean(np.square(array), axis=0)), 1)
    ]


def row_of(kind: str, id: str, known: Provenance, record: Mapping) -> dict:
    """Return the columns that every kind has, and those that the record gives."""
    row = {name: record.get(name) for name in KINDS[kind].fields.names}
    return row | {
        KINDS[kind].key: id,
        "created": datetime.now(UTC).replace(tzinfo=None),
        "code_hash": known.code_hash,
        "dirty": known.dirty,
    }


def one_row(kind: str, row: Mapping, extra: Mapping[str, str | None]) -> pa.Table:
    """Return a catalogue row as the file of a record has it.

    Raises:
        InputError: If a value is of another type than its column.
    """
    schema = KINDS[kind].fields
    try:
        table = pa.Table.from_pylist([dict(row)], schema=schema)
    except (pa.ArrowException, TypeError) as error:
        raise InputError(
            f"A record of {kind} does not fit its view: {error}"
        ) from error
    for name, text in extra.items():
        table = table.append_column(name, pa.array([text], pa.string()))
    return table


def _plain_name(name: str) -> str:
    if name != Path(name).name or name.startswith((".", "_")):
        raise InputError(f"'{name}' is not a file name for a record.")
    return name
