"""Whether records are what their ids say, one by one or a whole store, byte for byte.

A record is as it was committed where the hash of its content, taken once more, is its
id.
"""

import hashlib
import json
import shutil
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from itertools import chain, combinations
from pathlib import Path

import pyarrow as pa

from residual.errors import InputError, ModelgapError
from residual.robot.robot import load_robot
from warehouse import ids
from warehouse.commit import manifest_id
from warehouse.files import file_faults, read_parquet, table_hash, to_arrays
from warehouse.layout import Found, list_folders
from warehouse.provenance import MADE_WITH, check_packages
from warehouse.remote import bring, bring_file, fetched_anew, names_in
from warehouse.runs import ROBOTS, open_seal
from warehouse.schema import (
    KINDS,
    QUARANTINE,
    SAMPLES_FILE,
    SEALED,
    SIGNALS,
    VIEWS,
    arrow_schema,
)
from warehouse.sums import SUMS

_OPEN_TO_OTHERS = 0o077
_OTHER_FORM = (LookupError, TypeError, ValueError, AttributeError, RecursionError)

# Columns of the records with a number for an id, which must be those of the record.
_SAME = {
    "adoptions": ("robot", "serial", "model_id", "parent"),
    "decisions": ("loop", "number", "action", "reason", "made"),
}


def faults(found: Found) -> tuple[str, ...]:
    """Return what is not as it was committed, a line each; empty for a good record."""
    wrong = file_faults(found.folder)
    if wrong:
        return wrong
    try:
        row = read_row(found)
        key = KINDS[found.kind].key
        if row.get(key) != found.id:
            return (f"its row says {row.get(key)}, its folder {found.id}",)
        _check_form(found)
        return tuple(_CHECKS.get(found.kind, _faults_of_record)(found, row))
    except InputError as error:
        return (str(error),)
    # A row of another form is no record of ours, whatever it holds.
    except (*_OTHER_FORM, pa.ArrowException) as error:
        return (f"{found.row.name} has another form than expected: {error}",)


def read_row(found: Found) -> dict:
    """Return the row of a record, everything in it."""
    table = read_parquet(found.row)
    if len(table) != 1:
        raise InputError(f"{found.row} has {len(table)} rows, expected 1.")
    return table.to_pylist()[0]


def list_tables(found: Found) -> dict[str, pa.Table]:
    """Return the rows of views that lie in a record's own row, such as its errors."""
    lists = set(KINDS[found.kind].lists) - {"lineage"}
    row = read_parquet(found.row, sorted(lists)).to_pylist()[0]
    schemas = {view: arrow_schema(VIEWS[view][1:]) for view in sorted(lists)}
    return {
        view: pa.Table.from_pylist(row.get(view) or [], schema=schema)
        for view, schema in schemas.items()
    }


def other_files(found: Found) -> dict[str, Path]:
    """Return the files of a record beside its row, by their names."""
    bring(found.folder)
    paths = sorted(p for p in found.folder.iterdir() if p.is_file())
    own = {KINDS[found.kind].row, SUMS}
    return {p.name: p for p in paths if p.name not in own}


def _check_form(found: Found) -> None:
    """Check that a row has the types of its view: another stops every query."""
    table = read_parquet(found.row)
    for field in KINDS[found.kind].fields:
        if field.name in table.column_names:
            table.column(field.name).cast(field.type)
    for name in KINDS[found.kind].needed:
        if table.column(name).null_count:
            raise ValueError(f"its {name} has no value")
    for parent in table.column("lineage")[0].as_py() or []:
        ids.check_id(parent["parent"])


def _faults_of_run(found: Found, row: Mapping) -> Iterator[str]:
    manifest = json.loads(row["manifest"])
    samples = found.folder / SAMPLES_FILE
    arrays = to_arrays(read_parquet(samples))
    data = ids.data_hash(arrays)
    if data != manifest["data_hash"] or data != row["data_hash"]:
        yield f"{samples.name}: its values are not those that were committed"
    # SQL is made of these, so they must be no more than what the samples are.
    if set(row["signals"]) != set(arrays) or not set(arrays) <= set(SIGNALS):
        yield f"{found.row.name} names channels {row['signals']}, not those it has"
    elif (row["rows"], row["dof"]) != arrays["q"].shape:
        yield f"{found.row.name} says other numbers of samples or joints than it has"
    if row["robot"] != found.folder.parent.name.removeprefix("robot="):
        yield f"{found.row.name} is of {row['robot']}, its folder of another robot"
    if set(other_files(found)) != {SAMPLES_FILE}:
        yield f"{found.folder.name} has files that are none of a run"
    if manifest_id(manifest) != found.id:
        yield f"{found.row.name}: its spec is not the one that its id is the hash of"


def _faults_of_record(found: Found, row: Mapping) -> Iterator[str]:
    record, lineage = json.loads(row["record"]), row["lineage"] or []
    lists = list_tables(found)
    sums = {
        path.stem if path.suffix == ".parquet" else path.name: _sum(path)
        for path in other_files(found).values()
    }
    # An empty list was either not given or given as a table without rows.
    full = {view: table_hash(t) for view, t in lists.items() if len(t)}
    empty = {view: table_hash(t) for view, t in lists.items() if not len(t)}
    sizes = range(len(empty), -1, -1)
    for names in chain.from_iterable(combinations(empty, size) for size in sizes):
        told = sums | full | {name: empty[name] for name in names}
        if ids.digest(found.kind, record, lineage, told)[: ids.ID_DIGITS] == found.id:
            return
    yield f"{found.folder.name}: its content is not the one that its id is the hash of"


def _faults_of_numbered(found: Found, row: Mapping) -> Iterator[str]:
    record = json.loads(row["record"])
    for key in _SAME[found.kind]:
        if record[key] != row[key]:
            yield f"{found.row.name} has another {key} than its record"
    own = found.kind != "decisions" or ids.decision_id(record["loop"], record["number"])
    if own not in (True, found.id):
        yield f"{found.folder.name}: its id is not that of its loop and number"


_CHECKS = {"runs": _faults_of_run, **dict.fromkeys(_SAME, _faults_of_numbered)}


def _sum(path: Path) -> str:
    if path.suffix == ".parquet":
        return table_hash(read_parquet(path))
    return hashlib.sha256(path.read_bytes()).hexdigest()


@dataclass(frozen=True, slots=True)
class Verified:
    """One thing in a store."""

    kind: str  # kind of record, or the folder of the store that it is in
    id: str  # its id, or the name of its file
    faults: tuple[str, ...]  # what is not as it was committed, a line each


def verify_all(store: Path) -> Iterator[Verified]:
    """Verify every record, seal, robot, patch and tombstone of a store, one by one.

    Those of a bucket are fetched anew for it, and none is kept.
    """
    with fetched_anew(store) as place:
        whole = set()
        for kind in KINDS:
            for id, folder in list_folders(place, kind).items():
                wrong = faults(Found(kind, id, Path(folder)))
                yield Verified(kind, id, wrong)
                if place != store:
                    shutil.rmtree(folder, ignore_errors=True)
                if kind == "runs" and not wrong:
                    whole.add(id)
        yield from _verify_other(place, whole)


def _verify_other(place: Path, runs: Collection[str]) -> Iterator[Verified]:
    """Verify what is no record of its own; `runs` are those that are whole."""
    for name in names_in(place, SEALED):
        id, folder = name.removeprefix("run_id="), place / SEALED / name
        # Of a run that is damaged or gone only the bytes of its seal are verified.
        opened = _complaint(open_seal, place, id) if id in runs else ()
        yield Verified(SEALED, id, file_faults(folder) or opened)
    for name in names_in(place, ROBOTS):
        folder = place / ROBOTS / name
        yield Verified(
            ROBOTS, name, file_faults(folder) or _complaint(check_robot, folder)
        )
    for top, check in ((MADE_WITH, check_packages), (QUARANTINE, _check_tombstone)):
        for name in names_in(place, top):
            yield Verified(
                top, name, _complaint(_check_content, place / top / name, check)
            )


def open_to_others(store: Path) -> bool:
    """Return whether other users of this machine may look into a store."""
    return bool(store.stat().st_mode & _OPEN_TO_OTHERS)


def check_robot(folder: Path) -> None:
    """Check that a kept robot is the one that its folder names."""
    if load_robot(folder).content_hash != folder.name.removeprefix("sha256="):
        raise ValueError(f"{folder.name} describes another robot than its name says")


def _check_content(path: Path, check: Callable) -> None:
    bring_file(path)
    check(path.name, path.read_bytes())


def _check_tombstone(name: str, content: bytes) -> None:
    """Check that a tombstone is about the run that its name says."""
    if f"run_id={json.loads(content)['run_id']}.json" != name:
        raise ValueError(f"{name} is about another run than its name says")


def _complaint(check: Callable, *about: object) -> tuple[str, ...]:
    """Return what a check says against something, whatever is wrong with it."""
    try:
        check(*about)
    except (ModelgapError, OSError, ValueError, KeyError, RecursionError) as error:
        return (" ".join(str(error).split()),)
    return ()
