"""Commit records to the store: each becomes visible completely or not at all.

The number of an adoption is taken once, because its folder is renamed into place; the
second writer gets an error.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pyarrow as pa

from residual.errors import InputError, check_keys, check_name
from residual.recording import Recording
from warehouse import record_ids
from warehouse.code_provenance import build_origin_columns, read_code_provenance, store_package_list
from warehouse.record_ids import build_record_path
from warehouse.remote_store import find_store_bucket, is_record_local
from warehouse.store_catalogue import (
    ADOPTIONS,
    SPEC,
    TRUTH,
    ModelAdoption,
    SealedTruth,
    find_last_adoption,
    find_run,
    hash_sealed_spec,
    list_record_folders,
)
from warehouse.store_files import (
    arrays_to_table,
    create_staging_folder,
    flush_to_disk,
    hash_table,
    publish_folder,
    read_parquet,
    read_row_text,
    write_parquet,
)
from warehouse.view_schema import KINDS, LOGGED, NOT_HASHED, SAMPLES_FILE, SIGNALS, build_view_table

Array = np.ndarray
Parents = Sequence[str | tuple[str, str]] | Mapping[str, Sequence[str]]


def commit_run(
    store: Path,
    recording: Recording,
    manifest: Mapping,
    sealed: SealedTruth | None = None,
    extra: Mapping[str, Array] | None = None,
) -> str:
    """Store a run; an existing one of the same id is kept.

    Args:
        manifest: Its origin. Keys that a caller gives: ``spec`` (the open half:
            robot, trajectory, declared effects, rates, reference seed), ``source``,
            ``kind``, ``trajectory``, ``seed``, ``robot_hash``, ``seed_streams``,
            ``timings``, ``parents``, ``serial``, ``tags`` (texts) and ``recorded_at``
            (of the first sample, ISO 8601, UTC), where they are known; others are
            kept as they are. The commit adds ``sealed_sha256``,
            ``provenance``, ``data_hash``, ``truth_hash`` and ``units``. With ``spec``
            it is a simulated run; without, a measured one, which needs ``robot_hash``.
    """
    arrays = _channels(recording, extra or {})
    units = {name: SIGNALS[name].unit for name in arrays}
    # Writing and hashing take most of the time, so they run on two cores. If the run
    # exists already, the file is thrown away.
    with create_staging_folder(store, "run") as folder, ThreadPoolExecutor(1) as beside:

        def write() -> None:
            write_parquet(folder / SAMPLES_FILE, arrays_to_table(arrays, units))
            if find_store_bucket(store) is None:
                flush_to_disk(folder / SAMPLES_FILE)

        writing = beside.submit(write)
        full = {
            **record_ids.convert_to_json_types(manifest),
            "provenance": asdict(read_code_provenance()),
            "data_hash": record_ids.hash_arrays(arrays),
            "sealed_sha256": sealed and hash_sealed_spec(sealed.spec),
            "truth_hash": sealed and record_ids.hash_arrays(sealed.truth),
            "units": units,
        }
        if recording.drive is not None:
            full["drive"] = record_ids.convert_to_json_types(asdict(recording.drive))
        id = compute_manifest_id(full)
        target = build_record_path(store, "runs", id, recording.robot)
        if not _is_there(target, "runs"):
            row = _run_row(id, recording, full, arrays)
            store_package_list(store)
            # The seal first, so that every visible run has its truth.
            if sealed:
                commit_seal(store, id, sealed)
            write_parquet(folder / KINDS["runs"].row, row)
            writing.result()
            publish_folder(folder, target)
    return id


def commit_seal(store: Path, run_id: str, sealed: SealedTruth) -> None:
    """Store a hidden half; an existing one is kept."""
    target = record_ids.build_seal_path(store, run_id)
    if is_record_local(target):
        return
    units = {name: SIGNALS[name].unit for name in sealed.truth if name in SIGNALS}
    with create_staging_folder(store, f"sealed-{run_id}") as folder:
        (folder / SPEC).write_bytes(record_ids.encode_canonical_json(sealed.spec))
        write_parquet(folder / TRUTH, arrays_to_table(sealed.truth, units))
        publish_folder(folder, target)


def compute_imported_run_id(recording: Recording, robot_hash: str) -> str:
    """Return the run id of a measured recording, stored or not."""
    return record_ids.compute_measured_run_id(
        record_ids.hash_arrays(_channels(recording, {})), robot_hash
    )


def commit_record(
    store: Path,
    kind: str,
    record: Mapping,
    tables: Mapping[str, pa.Table] | None = None,
    parents: Parents = (),
    files: Mapping[str, bytes] | None = None,
    seconds: Mapping[str, float] | None = None,
) -> str:
    """Put a model, diagnosis, validation, campaign or report into the store.

    Args:
        record: Its content as JSON values; a key with the name of a column of the view
            becomes that column.
        tables: ``errors`` and ``effects`` become rows of these views (columns as in
            ``schema.VIEWS``, without the record's own id); others become files.
        files: Other files by name, such as the page of a report.
        seconds: Time that each step took [s], which is no part of the id.

    Returns:
        Its id: a hash of all of that, so the same record is kept once.
    """
    if check_name(kind, KINDS, "kind of record") == "runs":
        raise InputError("Runs are committed by commit_run, other records here.")
    tables, files = dict(tables or {}), dict(files or {})
    record, lineage = (record_ids.convert_to_json_types(record), build_lineage_rows(parents))
    sums = {name: hash_table(table) for name, table in tables.items()}
    sums |= {name: hashlib.sha256(data).hexdigest() for name, data in files.items()}
    id = record_ids.hash_values(kind, record, lineage, sums)[: record_ids.ID_DIGITS]
    if not _is_there(build_record_path(store, kind, id), kind):
        views = set(KINDS[kind].nested_views) - NOT_HASHED
        lists = {v: tables.pop(v).to_pylist() if v in tables else [] for v in views}
        lists |= {"lineage": lineage, "timings": _timing_rows(seconds or {})}
        for name in (*tables, *files):
            if name != Path(name).name or name.startswith((".", "_")):
                raise InputError(f"'{name}' is not a file name for a record.")
        beside = {f"{name}.parquet": table for name, table in tables.items()} | files
        commit_catalogue_row(store, kind, id, record, lists, beside)
    return id


def _timing_rows(seconds: Mapping[str, float]) -> list[dict]:
    return [{"step": step, "seconds": round(value, 3)} for step, value in seconds.items()]


def commit_catalogue_row(
    store: Path,
    kind: str,
    id: str,
    record: Mapping,
    lists: Mapping[str, Sequence[Mapping]],
    files: Mapping[str, pa.Table | bytes] | None = None,
) -> bool:
    """Put a record of a known id into the store; return False if the id was taken."""
    kinds, origin = KINDS[kind], asdict(read_code_provenance())
    row = {name: record.get(name) for name in kinds.fields.names} | _common_columns(kind, id)
    texts = {"record": record, "provenance": origin}
    texts = {k: json.dumps(v, ensure_ascii=False) for k, v in texts.items()}
    table = _one_row(kind, {**row, **lists}, texts)
    store_package_list(store)
    with create_staging_folder(store, f"{kind}-{id}") as folder:
        for name, content in (files or {}).items():
            if isinstance(content, pa.Table):
                write_parquet(folder / name, content)
            else:
                (folder / name).write_bytes(content)
        write_parquet(folder / kinds.row, table)
        return publish_folder(folder, build_record_path(store, kind, id))


def build_lineage_rows(parents: Parents) -> list[dict]:
    """Return ids, pairs of id and role, or ids by role as rows of `lineage`, without the child."""
    if isinstance(parents, Mapping):
        pairs = [(id, name) for name, ids in parents.items() for id in ids]
    else:
        pairs = [(p, "input") if isinstance(p, str) else tuple(p) for p in parents]
    rows = [{"parent": record_ids.check_record_id(id), "role": str(name)} for id, name in pairs]
    if len({tuple(row.values()) for row in rows}) < len(rows):
        raise InputError("A parent is given twice in one role, expected it once.")
    return rows


def build_run_columns(manifest: Mapping) -> dict:
    """Return the columns of ``runs`` that come from the manifest."""
    spec = manifest.get("spec") or {}
    motion = spec.get("trajectory") or {}
    motion = motion.get("kind") if isinstance(motion, Mapping) else motion
    simulated = "spec" in manifest
    recorded = manifest.get("recorded_at")
    try:  # UTC without a zone, as in the columns
        moment = recorded and datetime.fromisoformat(recorded)
        moment = moment and moment.astimezone(UTC).replace(tzinfo=None)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"'{recorded}' is not a time in ISO 8601, such as 2026-11-22T10:30:00Z."
        ) from error
    return {
        "serial": manifest.get("serial"),
        "recorded_at": moment,
        "tags": list(manifest.get("tags") or ()),
        "source": manifest.get("source", "simulated" if simulated else "imported"),
        "kind": manifest.get("kind", "experiment" if simulated else "log"),
        "trajectory": manifest.get("trajectory", motion),
        "seed": manifest.get("seed", spec.get("seed")),
        **build_origin_columns(manifest),
        "log": (manifest.get("log") or {}).get("file"),
    }


def _channels(recording: Recording, extra: Mapping[str, Array]) -> dict[str, Array]:
    check_keys(extra, set(SIGNALS) - set(LOGGED), "the extra channels of a run")
    logged = {name: getattr(recording, name) for name in LOGGED}
    arrays = {k: v for k, v in {**logged, **extra}.items() if v is not None}
    for name, array in arrays.items():
        if name != "t" and np.shape(array) != recording.q.shape:
            raise InputError(f"{name} has shape {np.shape(array)}, expected {recording.q.shape}.")
    return arrays


def compute_manifest_id(manifest: Mapping) -> str:
    """Return the run id of a complete manifest."""
    if manifest.get("spec") is not None:
        code_hash = manifest["provenance"]["code_hash"]
        return record_ids.compute_simulated_run_id(
            manifest["spec"], manifest["sealed_sha256"], code_hash
        )
    if not manifest.get("robot_hash"):
        raise InputError(
            "A run needs 'spec' in its manifest, or 'robot_hash' where it was measured."
        )
    return record_ids.compute_measured_run_id(manifest["data_hash"], manifest["robot_hash"])


def _is_there(target: Path, kind: str) -> bool:
    """Whether a record exists; a damaged one is an error, not repaired."""
    if not is_record_local(target):
        return False
    read_parquet(target / KINDS[kind].row, [KINDS[kind].key])
    return True


def _run_row(id: str, recording: Recording, full: Mapping, arrays: Mapping) -> pa.Table:
    about = build_run_columns(full)
    same = {"run_id": id, "trajectory": about["trajectory"], "stage": "twin"}
    row = {
        **about,
        **_common_columns("runs", id),
        "robot": recording.robot,
        "duration_s": recording.duration,
        "rows": len(recording.t),
        "dof": recording.dof,
        "data_hash": full["data_hash"],
        "signals": list(arrays),
        "lineage": build_lineage_rows(full.get("parents") or ()),
        "timings": _timing_rows(
            {k.removesuffix("_s"): v for k, v in (full.get("timings") or {}).items()}
        ),
        # Root mean square of each error against the twin, joint by joint.
        "errors": [
            {**same, "joint": joint, "metric": f"rms_{name}", "value": float(value)}
            for name, array in arrays.items()
            if name.startswith("e_")
            for joint, value in enumerate(np.sqrt(np.mean(np.square(array), axis=0)), 1)
        ],
    }
    extra = {
        "spec": record_ids.encode_canonical_json(full.get("spec")).decode(),
        "sealed_sha256": full["sealed_sha256"],
        "manifest": json.dumps(full, ensure_ascii=False, allow_nan=False),
    }
    return _one_row("runs", row, extra)


def _common_columns(kind: str, id: str) -> dict:
    """Return the columns that the rows of every kind have."""
    return {
        KINDS[kind].key: id,
        "created": datetime.now(UTC).replace(tzinfo=None),
        "code_hash": read_code_provenance().code_hash,
        "dirty": read_code_provenance().dirty,
    }


def _one_row(kind: str, row: Mapping, extra: Mapping[str, str | None]) -> pa.Table:
    """Return a catalogue row as the file of a record has it."""
    try:
        table = pa.Table.from_pylist([dict(row)], schema=KINDS[kind].fields)
    except (pa.ArrowException, TypeError) as error:
        raise InputError(f"A record of {kind} does not fit its view: {error}") from error
    for name, text in extra.items():
        table = table.append_column(name, pa.array([text], pa.string()))
    return table


def commit_diagnosis(
    store: Path,
    record: Mapping,
    model: Mapping,
    runs: Mapping[str, Sequence[str]],
    *,
    effects: Sequence[Mapping] = (),
    errors: Sequence[Mapping] = (),
    tables: Mapping[str, pa.Table] | None = None,
    beside: Mapping[str, pa.Table] | None = None,
    nominal: str | None = None,
    seconds: Mapping[str, float] | None = None,
) -> str:
    """Put a diagnosis and its model into the store.

    Args:
        record: Columns of the view diagnoses, except ``model_id``, and more.
        model: The record of its final model; ``stage`` if that is not "augmented".
        runs: Ids of its runs, by role: fit, baseline, held_out.
        effects: Rows of the view effects.
        errors: Rows of the view errors, but for ``trajectory``; those without a
            ``run_id`` are over all held-out runs.
        tables: Other tables, such as curves.
        beside: Tables of its model: the motion of its logs.
        nominal: Id of the diagnosis whose model was the nominal one, if any.
        seconds: Time that each step took [s].

    Returns:
        The id of the diagnosis; the same one on the same runs has the same.
    """
    roles = {role: list(ids) for role, ids in runs.items() if ids}
    motions = {
        id: read_row_text(find_run(store, id).row, "trajectory")
        for ids in roles.values()
        for id in ids
    }
    model = {"robot": record["robot"], "stage": "augmented", **model}
    before = {"nominal": [nominal]} if nominal else {}
    fitted = {role: ids for role, ids in roles.items() if role != "held_out"} | before
    model_id = commit_record(store, "models", model, beside, fitted)
    # Errors over one held-out run, or one kind of motion, belong to it.
    held_out = roles.get("held_out", [])
    kinds = {motions[id] for id in held_out}
    same = {
        "run_id": held_out[0] if len(held_out) == 1 else None,
        "trajectory": kinds.pop() if len(kinds) == 1 else None,
    }
    rows = [
        row | ({"trajectory": motions.get(row["run_id"])} if row.get("run_id") else same)
        for row in map(dict, errors)
    ]
    tables = {
        **(tables or {}),
        "errors": build_view_table("errors", rows),
        "effects": build_view_table("effects", effects),
    }
    record = {**record, "model_id": model_id}
    parents = {**roles, **before, "model": [model_id]}
    return commit_record(store, "diagnoses", record, tables, parents, None, seconds)


_DIGITS = 6


class AdoptionConflictError(InputError):
    """Another user has given the robot a model in the meantime."""


def commit_adoption(store: Path, adoption: ModelAdoption) -> str:
    """Store an adoption under the next number.

    Raises:
        AdoptionConflictError: If the robot has got another model since.
    """
    record_ids.check_robot_name(adoption.robot)
    parents = {"model": [adoption.model_id], "diagnosis": [adoption.diagnosis_id]}
    lineage = build_lineage_rows(
        {k: ids_of_role for k, ids_of_role in parents.items() if ids_of_role[0]}
    )
    while True:
        numbers = list_record_folders(store, ADOPTIONS)
        _check_parent(store, adoption)
        id = f"{1 + max(map(int, numbers), default=0):0{_DIGITS}}"
        # If another writer takes the number, check the parent again.
        if commit_catalogue_row(store, ADOPTIONS, id, asdict(adoption), {"lineage": lineage}):
            return id


def _check_parent(store: Path, adoption: ModelAdoption) -> None:
    last = find_last_adoption(store, adoption.robot, adoption.serial)
    if (last[0] if last else None) == adoption.parent:
        return
    id, other = last
    raise AdoptionConflictError(
        f"{other.who} has meanwhile changed the model of {adoption.robot} (adoption "
        f"{int(id)}: {other.action} {other.model_id or 'the nominal model'}). Nothing "
        "was changed. See modelgap models, and try again if your change still applies."
    )
