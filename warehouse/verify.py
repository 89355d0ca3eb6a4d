"""Whether a store is as it was written: files by their sums, records by their ids."""

import hashlib
import json
import shutil
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import chain, combinations
from pathlib import Path

import pyarrow as pa

from residual.errors import InputError, ModelgapError
from residual.robot.robot import load_robot
from warehouse import ids
from warehouse.commit import manifest_id
from warehouse.files import file_faults, read_parquet, table_hash, to_arrays
from warehouse.layout import StoredRecord, list_folders
from warehouse.provenance import MADE_WITH, check_packages
from warehouse.remote import fetch_file, fetch_record, fetched_anew, names_in
from warehouse.runs import ROBOTS, open_seal
from warehouse.schema import (
    KINDS,
    QUARANTINE,
    SAMPLES_FILE,
    SEALED,
    VIEWS,
    arrow_schema,
)
from warehouse.sums import SUMS

_OPEN_TO_OTHERS = 0o077
_NUMBERED = ("adoptions", "decisions")  # their ids are no hashes


def faults(found: StoredRecord) -> tuple[str, ...]:
    """Return what is not as it was committed, a line each; empty for a good record.

    The files have their SHA-256, and the hash of the content is the id: of a run its
    values have the hash that its manifest says.
    """
    if wrong := file_faults(found.folder):
        return wrong
    try:
        row = read_row(found)
        key = KINDS[found.kind].key
        if row.get(key) != found.id:
            return (f"its row says {row.get(key)}, its folder {found.id}",)
        if found.kind in _NUMBERED:
            return ()
        check = _run_fault if found.kind == "runs" else _record_fault
        fault = check(found, row)
    except InputError as error:
        return (str(error),)
    except (
        LookupError,
        TypeError,
        ValueError,
        AttributeError,
        RecursionError,
    ) as error:
        return (f"{found.row.name} has another form than expected: {error}",)
    return (fault,) if fault else ()


def read_row(found: StoredRecord) -> dict:
    """Return the row of a record, everything in it."""
    table = read_parquet(found.row)
    if len(table) != 1:
        raise InputError(f"{found.row} has {len(table)} rows, expected 1.")
    return table.to_pylist()[0]


def list_tables(found: StoredRecord) -> dict[str, pa.Table]:
    """Return the rows of views that lie in a record's own row, such as its errors."""
    lists = sorted(set(KINDS[found.kind].lists) - {"lineage"})
    row = read_parquet(found.row, lists).to_pylist()[0]
    schemas = {view: arrow_schema(VIEWS[view][1:]) for view in lists}
    return {
        view: pa.Table.from_pylist(row.get(view) or [], schema=schema)
        for view, schema in schemas.items()
    }


def other_files(found: StoredRecord) -> dict[str, Path]:
    """Return the files of a record beside its row, by their names."""
    fetch_record(found.folder)
    paths = sorted(p for p in found.folder.iterdir() if p.is_file())
    return {p.name: p for p in paths if p.name not in (KINDS[found.kind].row, SUMS)}


def _run_fault(found: StoredRecord, row: Mapping) -> str | None:
    manifest = json.loads(row["manifest"])
    arrays = to_arrays(read_parquet(found.folder / SAMPLES_FILE))
    if ids.data_hash(arrays) != manifest["data_hash"]:
        return f"{SAMPLES_FILE}: its values are not those that were committed"
    if manifest_id(manifest) != found.id:
        return f"{found.row.name}: its spec is not the one that its id is the hash of"
    return None


def _record_fault(found: StoredRecord, row: Mapping) -> str | None:
    record, lineage = json.loads(row["record"]), row["lineage"] or []
    sums = {}
    for path in other_files(found).values():
        if path.suffix == ".parquet":
            sums[path.stem] = table_hash(read_parquet(path))
        else:
            sums[path.name] = hashlib.sha256(path.read_bytes()).hexdigest()
    # An empty list was either not given or given as a table without rows.
    empty = {}
    for view, table in list_tables(found).items():
        (sums if len(table) else empty)[view] = table_hash(table)
    sizes = range(len(empty), -1, -1)
    for names in chain.from_iterable(combinations(empty, size) for size in sizes):
        hashes = sums | {name: empty[name] for name in names}
        digest = ids.digest(found.kind, record, lineage, hashes)
        if digest[: ids.ID_DIGITS] == found.id:
            return None
    return f"{found.folder.name}: its content is not the one that its id is the hash of"


@dataclass(frozen=True, slots=True)
class Integrity:
    """One thing in a store."""

    kind: str  # kind of record, or the folder of the store that it is in
    id: str  # its id, or the name of its file
    faults: tuple[str, ...]  # what is not as it was committed, a line each


def verify_all(store: Path) -> Iterator[Integrity]:
    """Verify every record, seal, robot, list of packages and tombstone, one by one.

    Those of a bucket are fetched anew for it, and none is kept.
    """
    with fetched_anew(store) as place:
        whole = set()
        for kind in KINDS:
            for id, folder in list_folders(place, kind).items():
                wrong = faults(StoredRecord(kind, id, Path(folder)))
                yield Integrity(kind, id, wrong)
                if place != store:
                    shutil.rmtree(folder, ignore_errors=True)
                if kind == "runs" and not wrong:
                    whole.add(id)
        for name in names_in(place, SEALED):
            id, folder = name.removeprefix("run_id="), place / SEALED / name
            # Of a run that is damaged or gone only the bytes of its seal are verified.
            opened = _complaint(open_seal, place, id) if id in whole else ()
            yield Integrity(SEALED, id, file_faults(folder) or opened)
        for name in names_in(place, ROBOTS):
            folder = place / ROBOTS / name
            wrong = file_faults(folder) or _complaint(_check_robot, folder)
            yield Integrity(ROBOTS, name, wrong)
        for top in (MADE_WITH, QUARANTINE):
            for name in names_in(place, top):
                yield Integrity(top, name, _complaint(_check_file, place / top / name))


def open_to_others(store: Path) -> bool:
    """Return whether other users of this machine may look into a store."""
    return bool(store.stat().st_mode & _OPEN_TO_OTHERS)


def _check_robot(folder: Path) -> None:
    if load_robot(folder).content_hash != folder.name.removeprefix("sha256="):
        raise ValueError(f"{folder.name} describes another robot than its name says")


def _check_file(path: Path) -> None:
    """Check a list of packages, or that a tombstone is about the run of its name."""
    fetch_file(path)
    content = path.read_bytes()
    if path.parent.name == MADE_WITH:
        check_packages(path.name, content)
    elif f"run_id={json.loads(content)['run_id']}.json" != path.name:
        raise ValueError(f"{path.name} is about another run than its name says")


def _complaint(check: Callable, *about: object) -> tuple[str, ...]:
    """Return what a check says against something, whatever is wrong with it."""
    try:
        check(*about)
    except (ModelgapError, OSError, ValueError, KeyError, RecursionError) as error:
        return (" ".join(str(error).split()),)
    return ()
