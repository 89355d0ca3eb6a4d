"""Commit records to the store: each becomes visible whole or not at all.

Adoptions are numbered records of which model a robot has. A number is taken once,
because its folder is renamed into place; the second writer gets an error. The last
adoption of a robot holds. A rollback is one more adoption, of the model before.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field, fields
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pyarrow as pa

from residual.errors import InputError, check_keys, check_name
from residual.recording import Recording
from warehouse import ids
from warehouse.files import (
    publish,
    read_cell,
    read_parquet,
    staging_folder,
    sync,
    table_hash,
    to_table,
    write_parquet,
)
from warehouse.ids import record_folder
from warehouse.layout import find_run, list_folders
from warehouse.provenance import keep_packages, origin_columns, provenance
from warehouse.remote import bucket_of, is_local
from warehouse.schema import KINDS, SAMPLES_FILE, SIGNALS, rows_table

Array = np.ndarray
Parents = Sequence[str | tuple[str, str]] | Mapping[str, Sequence[str]]

SPEC, TRUTH = "spec.json", "truth.parquet"
_LOGGED = ("t", "q", "qd", "qdd", "tau", "q_ref")


@dataclass(frozen=True, eq=False, slots=True)
class Seal:
    """The hidden half of a simulated run: hashed before, opened only afterwards.

    A diagnosis must not be able to look at what was planted. The hash in the run's
    manifest shows later that the truth was not changed to fit the verdict.
    """

    spec: Mapping  # the hidden half of the spec: effects, scatter, noise, salt
    # Channels that no robot logs. Shapes (n,) or (n, k).
    truth: Mapping[str, Array] = field(default_factory=dict)


def sealed_hash(spec: object) -> str:
    """Return the hash of a hidden half; its salt keeps it from being guessed."""
    return ids.digest(spec)


def commit_run(
    store: Path,
    recording: Recording,
    manifest: Mapping,
    sealed: Seal | None = None,
    extra: Mapping[str, Array] | None = None,
) -> str:
    """Put a run into the store; one of the same id that is there already stays.

    Args:
        manifest: How it came to be. Keys that a caller gives: ``spec`` (the open half:
            robot, trajectory, declared effects, rates, reference seed), ``source``,
            ``kind``, ``trajectory``, ``seed``, ``robot_hash``, ``seed_streams``,
            ``timings``, ``parents``; of a measured run ``serial``, ``recorded_at`` (of
            its first sample, ISO 8601, UTC) and ``tags`` (texts), where they are
            known; others are kept as they are. The commit adds ``sealed_sha256``,
            ``provenance``, ``data_hash``, ``truth_hash`` and ``units``. With ``spec``
            it is a simulated run; without, a measured one, which needs ``robot_hash``.
    """
    arrays = _channels(recording, extra or {})
    units = {name: SIGNALS[name].unit for name in arrays}
    # Writing and hashing take most of the time, so they run on two cores. If the run
    # exists already, the file is thrown away.
    with staging_folder(store, "run") as folder, ThreadPoolExecutor(1) as beside:

        def write() -> None:
            write_parquet(folder / SAMPLES_FILE, to_table(arrays, units))
            if bucket_of(store) is None:
                sync(folder / SAMPLES_FILE)

        writing = beside.submit(write)
        full = {
            **ids.to_plain(manifest),
            "provenance": asdict(provenance()),
            "data_hash": ids.data_hash(arrays),
            "sealed_sha256": sealed and sealed_hash(sealed.spec),
            "truth_hash": sealed and ids.data_hash(sealed.truth),
            "units": units,
        }
        id = manifest_id(full)
        target = record_folder(store, "runs", id, recording.robot)
        if not _is_there(target, "runs"):
            row = _run_row(id, recording, full, arrays)
            keep_packages(store)
            # The seal first, so that every visible run has its truth.
            if sealed:
                commit_seal(store, id, sealed)
            write_parquet(folder / KINDS["runs"].row, row)
            writing.result()
            publish(folder, target)
    return id


def commit_seal(store: Path, run_id: str, sealed: Seal) -> None:
    """Put a hidden half into the store; one that is there already stays."""
    target = ids.seal_folder(store, run_id)
    if is_local(target):
        return
    units = {name: SIGNALS[name].unit for name in sealed.truth if name in SIGNALS}
    with staging_folder(store, f"sealed-{run_id}") as folder:
        (folder / SPEC).write_bytes(ids.canonical(sealed.spec))
        write_parquet(folder / TRUTH, to_table(sealed.truth, units))
        publish(folder, target)


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
    """
    if check_name(kind, KINDS, "kind of record") == "runs":
        raise InputError("Runs are committed by commit_run, other records here.")
    tables, files = dict(tables or {}), dict(files or {})
    record, lineage = ids.to_plain(record), lineage_rows(parents)
    sums = {name: table_hash(table) for name, table in tables.items()}
    sums |= {name: hashlib.sha256(data).hexdigest() for name, data in files.items()}
    id = ids.digest(kind, record, lineage, sums)[: ids.ID_DIGITS]
    if not _is_there(record_folder(store, kind, id), kind):
        views = set(KINDS[kind].lists) - {"lineage"}
        lists = {v: tables.pop(v).to_pylist() if v in tables else [] for v in views}
        for name in (*tables, *files):
            if name != Path(name).name or name.startswith((".", "_")):
                raise InputError(f"'{name}' is not a file name for a record.")
        beside = {f"{name}.parquet": table for name, table in tables.items()} | files
        commit_row(store, kind, id, record, {**lists, "lineage": lineage}, beside)
    return id


def commit_row(
    store: Path,
    kind: str,
    id: str,
    record: Mapping,
    lists: Mapping[str, Sequence[Mapping]],
    beside: Mapping[str, pa.Table | bytes] | None = None,
) -> bool:
    """Put a record of a known id into the store, with its one catalogue row.

    Returns:
        Whether it is this one; False if the id was taken.
    """
    kinds, origin = KINDS[kind], asdict(provenance())
    row = {name: record.get(name) for name in kinds.fields.names} | _common_columns(
        kind, id
    )
    texts = {"record": record, "provenance": origin}
    texts = {k: json.dumps(v, ensure_ascii=False) for k, v in texts.items()}
    table = _one_row(kind, {**row, **lists}, texts)
    keep_packages(store)
    with staging_folder(store, f"{kind}-{id}") as folder:
        for name, content in (beside or {}).items():
            if isinstance(content, pa.Table):
                write_parquet(folder / name, content)
            else:
                (folder / name).write_bytes(content)
        write_parquet(folder / kinds.row, table)
        return publish(folder, record_folder(store, kind, id))


def lineage_rows(parents: Parents, role: str = "input") -> list[dict]:
    """Return parents as rows of the view ``lineage``, without the child.

    Args:
        parents: Ids, pairs of id and role, or lists of ids by role.
    """
    if isinstance(parents, Mapping):
        pairs = [
            (id, name) for name, ids_of_role in parents.items() for id in ids_of_role
        ]
    else:
        pairs = [(p, role) if isinstance(p, str) else tuple(p) for p in parents]
    rows = [{"parent": ids.check_id(id), "role": str(name)} for id, name in pairs]
    if len({tuple(row.values()) for row in rows}) < len(rows):
        raise InputError("A parent is given twice in one role, expected it once.")
    return rows


def run_columns(manifest: Mapping) -> dict:
    """Return the columns of ``runs`` that the manifest decides."""
    spec = manifest.get("spec") or {}
    motion = spec.get("trajectory") or {}
    motion = motion.get("kind") if isinstance(motion, Mapping) else motion
    simulated = "spec" in manifest
    recorded = manifest.get("recorded_at")
    try:  # UTC without saying so, as columns hold it
        moment = recorded and datetime.fromisoformat(recorded)
        moment = moment and moment.astimezone(UTC).replace(tzinfo=None)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"'{recorded}' is no moment in ISO 8601, such as 2026-11-22T10:30:00Z."
        ) from error
    return {
        "serial": manifest.get("serial"),
        "recorded_at": moment,
        "tags": list(manifest.get("tags") or ()),
        "source": manifest.get("source", "simulated" if simulated else "imported"),
        "kind": manifest.get("kind", "experiment" if simulated else "log"),
        "trajectory": manifest.get("trajectory", motion),
        "seed": manifest.get("seed", spec.get("seed")),
        **origin_columns(manifest),
        "log": (manifest.get("log") or {}).get("file"),
    }


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


def manifest_id(full: Mapping) -> str:
    """Return the id of the run that a whole manifest is of."""
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
    if not is_local(target):
        return False
    read_parquet(target / KINDS[kind].row, [KINDS[kind].key])
    return True


def _run_row(id: str, recording: Recording, full: Mapping, arrays: Mapping) -> pa.Table:
    about = run_columns(full)
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
        "lineage": lineage_rows(full.get("parents") or ()),
        # Root mean square of each error against the twin, joint by joint.
        "errors": [
            {**same, "joint": joint, "metric": f"rms_{name}", "value": float(value)}
            for name, array in arrays.items()
            if name.startswith("e_")
            for joint, value in enumerate(np.sqrt(np.mean(np.square(array), axis=0)), 1)
        ],
    }
    extra = {
        "spec": ids.canonical(full.get("spec")).decode(),
        "sealed_sha256": full["sealed_sha256"],
        "manifest": json.dumps(full, ensure_ascii=False, allow_nan=False),
    }
    return _one_row("runs", row, extra)


def _common_columns(kind: str, id: str) -> dict:
    """Return the columns that the rows of every kind have."""
    return {
        KINDS[kind].key: id,
        "created": datetime.now(UTC).replace(tzinfo=None),
        "code_hash": provenance().code_hash,
        "dirty": provenance().dirty,
    }


def _one_row(kind: str, row: Mapping, extra: Mapping[str, str | None]) -> pa.Table:
    """Return a catalogue row as the file of a record has it."""
    try:
        table = pa.Table.from_pylist([dict(row)], schema=KINDS[kind].fields)
    except (pa.ArrowException, TypeError) as error:
        raise InputError(
            f"A record of {kind} does not fit its view: {error}"
        ) from error
    for name, text in extra.items():
        table = table.append_column(name, pa.array([text], pa.string()))
    return table


@dataclass(frozen=True, eq=False, slots=True)
class DiagnosisRows:
    """What is kept of a diagnosis."""

    # Its record as JSON can hold it; with ``robot``, and what else the view diagnoses
    # shows, but for ``model_id``.
    record: Mapping
    # The record of the model it ends with; ``stage`` says if it is another than
    # augmented.
    model: Mapping
    effects: Sequence[Mapping] = ()  # rows of the view effects
    # Rows of the view errors, but for ``trajectory``; those without a ``run_id`` are
    # over all held-out runs.
    errors: Sequence[Mapping] = ()
    # Other tables of it, such as curves.
    tables: Mapping[str, pa.Table] = field(default_factory=dict)
    # Id of the diagnosis whose model was the nominal one, if any.
    nominal: str | None = None
    # Tables that go with its model: the motion that it is from.
    beside: Mapping[str, pa.Table] = field(default_factory=dict)


def store_rows(
    store: Path, rows: DiagnosisRows, runs: Mapping[str, Sequence[str]]
) -> str:
    """Put a diagnosis and its model into the store.

    Args:
        runs: Ids of the runs that it was made from, by role: fit, baseline, held_out.

    Returns:
        The id of the diagnosis; the same one on the same runs has the same.
    """
    roles = {role: list(ids) for role, ids in runs.items() if ids}
    motions = {
        id: read_cell(find_run(store, id).row, "trajectory")
        for ids in roles.values()
        for id in ids
    }
    model = {"robot": rows.record["robot"], "stage": "augmented", **rows.model}
    before = {"nominal": [rows.nominal]} if rows.nominal else {}
    fitted = {role: ids for role, ids in roles.items() if role != "held_out"} | before
    model_id = commit_record(store, "models", model, rows.beside, fitted)
    # What is over one held-out run, or over one kind of motion, is of it.
    held_out = roles.get("held_out", [])
    kinds = {motions[id] for id in held_out}
    same = {
        "run_id": held_out[0] if len(held_out) == 1 else None,
        "trajectory": kinds.pop() if len(kinds) == 1 else None,
    }
    errors = [
        row
        | ({"trajectory": motions.get(row["run_id"])} if row.get("run_id") else same)
        for row in map(dict, rows.errors)
    ]
    tables = {
        **rows.tables,
        "errors": rows_table("errors", errors),
        "effects": rows_table("effects", rows.effects),
    }
    record = {**rows.record, "model_id": model_id}
    parents = {**roles, **before, "model": [model_id]}
    return commit_record(store, "diagnoses", record, tables, parents)


ADOPTIONS = "adoptions"
ADOPTED, FORCED, ROLLED_BACK = "adopted", "forced", "rolled back"
_DIGITS = 6


class AdoptionConflictError(InputError):
    """Another user has given the robot a model in the meantime."""


@dataclass(frozen=True, slots=True)
class Adoption:
    """A robot gets a model."""

    robot: str
    serial: str | None  # its serial number, None where it has none
    action: str  # "adopted", "forced" or "rolled back"
    model_id: str | None  # id of the model, None for the nominal one
    diagnosis_id: str | None  # id of the diagnosis that found it
    parent: str | None  # id of the adoption before it, None for the first
    who: str  # name of the user
    note: str = ""  # what he wrote about it
    # Held-out error of the model before and of this one [%].
    before: float | None = None
    after: float | None = None
    evidence: Mapping | None = None  # everything that the gate saw


def commit_adoption(store: Path, adoption: Adoption) -> str:
    """Put an adoption into the store under the next number.

    Args:
        adoption: Its parent is what the robot had when it was judged.

    Raises:
        AdoptionConflictError: If the robot has got another model since.
    """
    ids.check_slug(adoption.robot)
    parents = {"model": [adoption.model_id], "diagnosis": [adoption.diagnosis_id]}
    lineage = lineage_rows(
        {k: ids_of_role for k, ids_of_role in parents.items() if ids_of_role[0]}
    )
    while True:
        numbers = list_folders(store, ADOPTIONS)
        _check_parent(store, adoption)
        id = f"{1 + max(map(int, numbers), default=0):0{_DIGITS}}"
        # If another writer takes the number, check the parent again.
        if commit_row(store, ADOPTIONS, id, asdict(adoption), {"lineage": lineage}):
            return id


def read_adoption(store: Path, id: str) -> Adoption:
    """Return an adoption; what else is in its record is left out."""
    row = record_folder(store, ADOPTIONS, id) / KINDS[ADOPTIONS].row
    record = json.loads(read_cell(row, "record"))
    return Adoption(**{each.name: record[each.name] for each in fields(Adoption)})


def adopted(
    store: Path, robot: str, serial: str | None = None
) -> tuple[str, Adoption] | None:
    """Return the last adoption of a robot with its number, None where there is none."""
    for id in sorted(list_folders(store, ADOPTIONS), reverse=True):
        adoption = read_adoption(store, id)
        if (adoption.robot, adoption.serial) == (robot, serial):
            return id, adoption
    return None


def _check_parent(store: Path, adoption: Adoption) -> None:
    last = adopted(store, adoption.robot, adoption.serial)
    if (last[0] if last else None) == adoption.parent:
        return
    id, other = last
    raise AdoptionConflictError(
        f"{other.who} has given {adoption.robot} another model meanwhile (adoption "
        f"{int(id)}: {other.action} {other.model_id or 'the nominal model'}). Nothing "
        "was changed. Look at it with modelgap models, and try again if it still holds."
    )
