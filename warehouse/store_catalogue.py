"""The layout of a store, how an id is found without an index, and the index.

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
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa

from residual.errors import InputError
from warehouse.record_ids import ID_DIGITS, check_record_id
from warehouse.remote_store import (
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
)
from warehouse.view_schema import INDEX, KINDS, RecordKind

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
