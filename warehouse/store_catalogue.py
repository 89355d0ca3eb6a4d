"""What a store holds: find a record by its id, read runs, seals and adoptions; the index.

The index (``_index``) is one Parquet file per kind with a copy of every catalogue row.
It may be deleted at any time: the next reader writes it again. The folders decide which
records exist; the index only saves reading them one by one. Of two concurrent writers
of the index the later wins, and rows that only the other had are read from their
records.
"""

import json
import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, fields
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from residual.drive import Drive
from residual.errors import InputError
from residual.recording import Recording
from warehouse.record_ids import (
    ID_DIGITS,
    build_record_path,
    build_seal_path,
    check_record_id,
    hash_arrays,
    hash_values,
)
from warehouse.remote_store import (
    fetch_file,
    fetch_index,
    find_store_bucket,
    format_store_name,
    list_committed_folders,
    list_folder_names,
    record_exists,
    upload_index,
)
from warehouse.store_files import (
    read_parquet,
    read_row_text,
    read_unverified_parquet,
    replace_file,
    sweep_staging,
    table_to_arrays,
    verify_file,
)
from warehouse.view_schema import INDEX, KINDS, LOGGED, QUARANTINE, SAMPLES_FILE, RecordKind

RERUN_OF = "rerun of"  # role of a record for its rerun


@dataclass(frozen=True, slots=True)
class StoredRecord:
    """A record that is in the store."""

    kind: str  # name of its kind, such as "runs"
    id: str
    folder: Path

    @property
    def row(self) -> Path:
        """The file with its catalogue row."""
        return self.folder / KINDS[self.kind].row


def list_record_folders(store: Path, kind: str) -> dict[str, str]:
    """Return the folder of every record of one kind, by id, in the order of ids."""
    if find_store_bucket(store):
        return list_committed_folders(store, KINDS[kind].folder)
    prefix = f"{KINDS[kind].key}="
    return dict(sorted(e for b in _bases(store, kind) for e in _entries(b, prefix)))


def find_record(store: Path, id: str) -> StoredRecord:
    """Find a record of any kind by its id or the beginning of it.

    Raises:
        InputError: If it is not an id, or none or several records begin with it.
    """
    check_record_id(id)
    matches: list[StoredRecord] = []
    for kind in KINDS:
        entries = _matches(store, kind, id)
        matches += [StoredRecord(kind, whole_id, Path(folder)) for whole_id, folder in entries]
        if matches and len(id) == ID_DIGITS:
            break
    if len(matches) == 1:
        return matches[0]
    if not matches:
        raise InputError(
            f"Nothing in {format_store_name(store)} has an id that begins with '{id}'. "
            "modelgap runs lists its runs."
        )
    some = ", ".join(f"{f.id} ({f.kind})" for f in matches[:4])
    more = f" and {len(matches) - 4} more" if len(matches) > 4 else ""
    raise InputError(f"'{id}' is the beginning of {some}{more}. Give more digits.")


def find_run(store: Path, id: str) -> StoredRecord:
    """Find a run by its id or the beginning of it."""
    record = find_record(store, id)
    if record.kind != "runs":
        raise InputError(f"{record.id} is in {record.kind}, expected the id of a run.")
    return record


def read_record(store: Path, id: str) -> dict:
    """Return the committed content of a record; for a run, its manifest."""
    record = find_record(store, id)
    return json.loads(read_row_text(record.row, "manifest" if record.kind == "runs" else "record"))


def list_record_ancestry(store: Path, id: str) -> list[StoredRecord]:
    """Return a record and all its ancestors, parents first."""
    order: dict[str, StoredRecord] = {}
    path: set[str] = set()

    def visit(record: StoredRecord) -> None:
        if record.id in order or record.id in path:
            return
        path.add(record.id)
        for id in list_parent_ids(store, record):
            try:
                parent = find_record(store, id)
            except InputError as error:
                raise InputError(
                    f"{record.id} ({record.kind}) was made from {id}, which is not in "
                    f"{format_store_name(store)}."
                ) from error
            visit(parent)
        order[record.id] = record

    visit(find_record(store, id))
    return list(order.values())


def list_parent_ids(store: Path, record: StoredRecord) -> list[str]:
    """Return the parent ids of a record: from its lineage and from its request."""
    rows = read_parquet(record.row, ["lineage"]).column("lineage")[0].as_py() or []
    ids = [row["parent"] for row in rows]
    if record.kind != "runs":
        ids += _ids_in((read_record(store, record.id) or {}).get("request"))
    return list(dict.fromkeys(check_record_id(id) for id in ids))


def _ids_in(value: object) -> list[str]:
    """Return all complete ids in a request."""
    if isinstance(value, Mapping):
        return [id for item in value.values() for id in _ids_in(item)]
    if isinstance(value, list):
        return [id for item in value for id in _ids_in(item)]
    is_id = isinstance(value, str) and len(value) == ID_DIGITS
    return [value] if is_id and not set(value) - set("0123456789abcdef") else []


def _matches(store: Path, kind: str, id: str) -> list[tuple[str, str]]:
    if len(id) < ID_DIGITS:
        return [e for e in list_record_folders(store, kind).items() if e[0].startswith(id)]
    # A complete id needs no listing: its path is known except the robot.
    spec, bases = KINDS[kind], _bases(store, kind)
    paths = [os.path.join(base, f"{spec.key}={id}") for base in bases]
    return [(id, path) for path in paths if record_exists(Path(path))]


def _bases(store: Path, kind: str) -> list[str]:
    """Return the folders that hold the records of a kind."""
    folder = KINDS[kind].folder
    if kind != "runs":
        return [str(store / folder)]
    robots = (name for name in list_folder_names(store, folder) if name.startswith("robot="))
    return [str(store / folder / name) for name in robots]


def _entries(folder: str, prefix: str) -> list[tuple[str, str]]:
    """Yield the name after the prefix, and the path, of each such entry of a folder."""
    try:
        with os.scandir(folder) as entries:
            return [
                (entry.name[len(prefix) :], entry.path)
                for entry in entries
                if entry.name.startswith(prefix)
            ]
    except FileNotFoundError:
        return []


# Missing rows of the index from which a reader adds them: reading one record takes about
# 1 ms, writing the index as long as reading some dozens.
_SPARE = 32
_AT_ONCE = 16  # records that are fetched from a bucket


@dataclass(frozen=True, eq=False, slots=True)
class StoreCatalogue:
    """All records of a store at one moment."""

    folders: Mapping[str, Mapping[str, str]]  # folder of every record, by kind and id
    rows: Mapping[str, pa.Table]  # catalogue rows by kind, oldest first
    # Messages about records whose row cannot be read, by kind; these are left out.
    damaged: Mapping[str, Sequence[str]]


def read_catalogue(store: Path, before: StoreCatalogue | None = None) -> StoreCatalogue:
    """List a store, and bring its index up to date where that pays.

    Args:
        before: An earlier catalogue, which is returned if nothing has changed.
    """
    folders = {kind: list_record_folders(store, kind) for kind in KINDS}
    if before is not None and before.folders == folders:
        return before
    rows, damaged = {}, {}
    for kind in KINDS.values():
        both = _rows(store, kind, folders[kind.name], before)
        rows[kind.name], damaged[kind.name] = both
    return StoreCatalogue(folders, rows, damaged)


def _rows(
    store: Path, kind: RecordKind, folders: Mapping[str, str], before: StoreCatalogue | None
) -> tuple[pa.Table, tuple[str, ...]]:
    """Return the rows of a kind, and messages about those that cannot be read."""
    listed = before.rows[kind.name] if before else _read_index(store, kind)
    ids = listed.column(kind.key).to_pylist()
    missing = sorted(folders.keys() - set(ids))
    kept = [row for row, id in enumerate(ids) if id in folders]
    if not missing and len(kept) == len(ids):
        return listed, ()  # the usual case, before Arrow loads its functions
    kept = listed.take(pa.array(kept, pa.int64()))
    paths = [Path(folders[id], kind.row) for id in missing]
    with ThreadPoolExecutor(_AT_ONCE if find_store_bucket(store) else 1) as pool:
        read = list(pool.map(lambda path: _read_row(path, kind), paths))
    rows = pa.concat_tables([kept, *(row for row in read if isinstance(row, pa.Table))])
    rows = rows.combine_chunks()
    rows = rows.sort_by([("created", "ascending"), (kind.key, "ascending")])
    added, gone = len(rows) - len(kept), len(listed) - len(kept)
    if before is None and (added > _SPARE or 4 * added >= len(listed) + 1 or gone):
        # A read-only store is read without an index.
        with suppress(OSError, InputError):
            sweep_staging(store)
            replace_file(store, store / INDEX / f"{kind.name}.parquet", rows)
            upload_index(store / INDEX / f"{kind.name}.parquet")
    return rows, tuple(each for each in read if isinstance(each, str))


def _read_row(path: Path, kind: RecordKind) -> pa.Table | str:
    """Read the columns of one catalogue row that its view has, or return the fault."""
    try:
        table = read_parquet(path, kind.fields.names)
    except InputError as error:
        return str(error)
    if "timings" in kind.fields.names and "timings" not in table.column_names:
        # Records of 0.1.0 have none.
        none = pa.nulls(len(table), kind.fields.field("timings").type)
        table = table.append_column("timings", none)
    if lacking := sorted(set(kind.fields.names) - set(table.column_names)):
        return (
            f"{path} is of another version: it lacks {', '.join(lacking)}, which every "
            f"record of {kind.name} has. Remove its folder from the store, and make or "
            "import it again."
        )
    return table.select(kind.fields.names).cast(kind.fields)


def _read_index(store: Path, kind: RecordKind) -> pa.Table:
    # Missing, incomplete, or of a version with other columns: it can be rebuilt.
    path = store / INDEX / f"{kind.name}.parquet"
    with suppress(InputError):
        fetch_index(path)
        table = read_unverified_parquet(path)
        if table.schema.equals(kind.fields):
            return table
    return kind.fields.empty_table()


# Runs, their seals, and the marks on those not to be used.

SPEC, TRUTH = "spec.json", "truth.parquet"


@dataclass(frozen=True, eq=False, slots=True)
class SealedTruth:
    """The hidden half of a simulated run: hashed before, opened only afterwards.

    A diagnosis must not be able to look at what was planted. The hash in the run's
    manifest shows later that the truth was not changed to fit the verdict.
    """

    spec: Mapping  # the hidden half of the spec: effects, scatter, noise, salt
    # Channels that no robot logs. Shapes (n,) or (n, k).
    truth: Mapping[str, np.ndarray] = field(default_factory=dict)


def hash_sealed_spec(spec: object) -> str:
    """Return the hash of a hidden half; its salt keeps it from being guessed."""
    return hash_values(spec)


def read_manifest(store: Path, run_id: str) -> dict:
    """Return the manifest of a run (`record_commit.commit_run` says what is in it)."""
    return _manifest(find_run(store, run_id).folder)


def _manifest(folder: Path) -> dict:
    return json.loads(read_row_text(folder / KINDS["runs"].row, "manifest"))


def read_run(store: Path, run_id: str) -> Recording:
    """Return the log of a run, bit for bit as committed."""
    run = find_run(store, run_id)
    channels = read_verified_channels(run.folder)
    robot = run.folder.parent.name.removeprefix("robot=")
    logged = {name: channels[name] for name in LOGGED if name in channels}
    if (drive := _manifest(run.folder).get("drive")) is not None:
        lists = {k: tuple(v) if isinstance(v, list) else v for k, v in drive.items()}
        logged["drive"] = Drive(**lists)
    return Recording(id=run.id, robot=robot, **logged)


def read_channels(store: Path, run_id: str) -> dict:
    """Return all channels of a run by name, the errors of the twin among them."""
    return read_verified_channels(find_run(store, run_id).folder)


def read_verified_channels(folder: Path) -> dict:
    """Return the channels in a folder of a run, held against its record's hash."""
    path = folder / SAMPLES_FILE
    arrays = table_to_arrays(read_parquet(path))
    if hash_arrays(arrays) != _manifest(folder)["data_hash"]:
        raise InputError(
            f"{path} is damaged: its values are not those that were committed. "
            "Remove its folder from the store."
        )
    return arrays


def open_seal(store: Path, run_id: str) -> SealedTruth:
    """Open the hidden half of a run: for reruns and for judging verdicts, only.

    Raises:
        InputError: If the run has no seal, or the seal is not the one that was hashed.
    """
    run = find_run(store, run_id)
    spec, path = read_sealed_spec(store, run), build_seal_path(store, run.id) / TRUTH
    truth = table_to_arrays(read_parquet(path))
    if hash_arrays(truth) != _manifest(run.folder)["truth_hash"]:
        raise _broken(run, path)
    return SealedTruth(spec, truth)


def read_sealed_spec(store: Path, run: StoredRecord) -> dict:
    """Open the hidden spec of a run, without its hidden channels."""
    path = build_seal_path(store, run.id) / SPEC
    if not record_exists(path.parent):
        raise InputError(f"Run {run.id} has no sealed half in {format_store_name(store)}.")
    verify_file(path)
    try:
        spec = json.loads(path.read_bytes())
    except ValueError as error:
        raise InputError(f"{path} is damaged: it is not JSON.") from error
    if hash_sealed_spec(spec) != read_row_text(run.row, "sealed_sha256"):
        raise _broken(run, path)
    return spec


def _broken(run: StoredRecord, path: Path) -> InputError:
    return InputError(
        f"The seal of run {run.id} is broken: {path.parent} is not the seal that was "
        "hashed when the run was made."
    )


def quarantine_run(store: Path, run_id: str, reason: str) -> Path:
    """Mark a run as not to be used, which it does not change; return the tombstone."""
    if not reason.strip():
        raise InputError("A quarantine needs a reason: it is shown with the run.")
    id = find_run(store, run_id).id
    return mark_run(store, QUARANTINE, id, {"reason": reason})


def mark_run(store: Path, mark: str, run_id: str, about: Mapping) -> Path:
    """Put a mark on a run, such as QUARANTINE; an existing one is kept."""
    target = _mark(store, mark, run_id)
    fetch_file(target)
    if not target.exists():
        content = {"run_id": run_id, **about, "at": datetime.now(UTC).isoformat()}
        replace_file(store, target, (json.dumps(content) + "\n").encode())
    return target


def list_marked_runs(store: Path, mark: str) -> frozenset[str]:
    """Return the ids of all runs with a mark, such as QUARANTINE."""
    names = list_folder_names(store, mark)
    names = (n[:-5] for n in names if n.startswith("run_id=") and n.endswith(".json"))
    ids = (name.removeprefix("run_id=") for name in names)
    return frozenset(check_record_id(id) for id in ids if len(id) == ID_DIGITS)


def read_quarantine_reason(store: Path, run_id: str) -> str | None:
    """Return why a run is in quarantine, None if it is not."""
    path = _mark(store, QUARANTINE, run_id)
    fetch_file(path)
    try:
        return str(json.loads(path.read_bytes()).get("reason"))
    except FileNotFoundError:
        return None
    except (ValueError, AttributeError):
        return "its tombstone cannot be read"


def _mark(store: Path, mark: str, run_id: str) -> Path:
    return store / mark / f"run_id={check_record_id(run_id)}.json"


# Adoptions: numbered records of which model a robot has. The last one of a robot holds; a
# rollback is one more adoption, of the model before.

ADOPTIONS = "adoptions"
ADOPTED, FORCED, ROLLED_BACK = "adopted", "forced", "rolled back"


@dataclass(frozen=True, slots=True)
class ModelAdoption:
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


def read_adoption(store: Path, id: str) -> ModelAdoption:
    """Return an adoption; what else is in its record is left out."""
    row = build_record_path(store, ADOPTIONS, id) / KINDS[ADOPTIONS].row
    record = json.loads(read_row_text(row, "record"))
    return ModelAdoption(**{f.name: record[f.name] for f in fields(ModelAdoption)})


def find_last_adoption(
    store: Path, robot: str, serial: str | None = None
) -> tuple[str, ModelAdoption] | None:
    """Return the last adoption of a robot with its number, None where there is none."""
    for id in sorted(list_record_folders(store, ADOPTIONS), reverse=True):
        adoption = read_adoption(store, id)
        if (adoption.robot, adoption.serial) == (robot, serial):
            return id, adoption
    return None


class AdoptionEntry(NamedTuple):
    """An adoption of a store, with its number and when it was made, in words."""

    number: str
    adoption: ModelAdoption
    since: str


def read_adoptions(store: Path) -> list[AdoptionEntry]:
    """Return all adoptions, the first one first."""
    out = []
    for id in list_record_folders(store, ADOPTIONS):
        path = build_record_path(store, ADOPTIONS, id) / KINDS[ADOPTIONS].row
        created = read_parquet(path, ["created"]).column("created")[0].as_py()
        since = f"{created:%Y-%m-%d %H:%M}"
        out.append(AdoptionEntry(id, read_adoption(store, id), since))
    return out


def describe_diagnosis_adoption(store: Path, diagnosis: str) -> str:
    """Return whether the model of a diagnosis is adopted, in one line."""
    entries = read_adoptions(store)
    last = {(record.robot, record.serial): id for id, record, _ in entries}
    for id, record, since in reversed(entries):
        if record.diagnosis_id == diagnosis:
            current = last[record.robot, record.serial] == id
            now = "the current model" if current else "replaced since"
            return f"adopted: adoption {int(id)} of {record.robot}, {since}; {now}"
    return f"not adopted: modelgap adopt {diagnosis[:8]}"
