"""Whether a record is what its id says: the hash of its content, taken once more."""

import hashlib
import json
from collections.abc import Iterator, Mapping
from itertools import chain, combinations
from pathlib import Path

import pyarrow as pa

from residual.errors import InputError
from warehouse import ids
from warehouse.files import read_parquet, table_hash, to_arrays
from warehouse.kinds import KINDS, SAMPLES_FILE
from warehouse.layout import Found
from warehouse.objects.mirror import brought
from warehouse.schema import SIGNALS, VIEWS, arrow_schema
from warehouse.sums import SUMS, file_faults

_OTHER_FORM = (
    KeyError,
    TypeError,
    ValueError,
    AttributeError,
    IndexError,
    RecursionError,
)


def faults(found: Found) -> tuple[str, ...]:
    """Return what is not as it was committed, a line each; empty for a good record."""
    brought(found.folder)
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
    """Return the row of a record, everything in it.

    Raises:
        InputError: If it is damaged.
    """
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
    brought(found.folder)
    paths = sorted(p for p in found.folder.iterdir() if p.is_file())
    own = {KINDS[found.kind].row, SUMS}
    return {p.name: p for p in paths if p.name not in own}


def _check_form(found: Found) -> None:
    """Check that a row has the types of its view: another stops every query."""
    table = read_parquet(found.row)
    for field in KINDS[found.kind].fields:
        if field.name in table.column_names:
            table.column(field.name).cast(field.type)
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
    if manifest.get("spec") is not None:
        code = manifest["provenance"]["code_hash"]
        id = ids.run_id(manifest["spec"], manifest["sealed_sha256"], code)
    else:
        id = ids.imported_id(manifest["data_hash"], manifest["robot_hash"])
    if id != found.id:
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
    for given in _subsets(empty):
        told = sums | full | given
        if ids.digest(found.kind, record, lineage, told)[: ids.ID_DIGITS] == found.id:
            return
    yield f"{found.folder.name}: its content is not the one that its id is the hash of"


def _faults_of_adoption(found: Found, row: Mapping) -> Iterator[str]:
    record = json.loads(row["record"])
    for key in ("robot", "serial", "model_id", "parent"):
        if record[key] != row[key]:
            yield f"{found.row.name} has another {key} than its record"


def _faults_of_decision(found: Found, row: Mapping) -> Iterator[str]:
    record = json.loads(row["record"])
    for key in ("loop", "number", "action", "reason", "made"):
        if record[key] != row[key]:
            yield f"{found.row.name} has another {key} than its record"
    if ids.decision_id(record["loop"], record["number"]) != found.id:
        yield f"{found.folder.name}: its id is not that of its loop and number"


_CHECKS = {
    "runs": _faults_of_run,
    "adoptions": _faults_of_adoption,
    "decisions": _faults_of_decision,
}


def _subsets(items: Mapping[str, str]) -> Iterator[dict[str, str]]:
    sizes = range(len(items), -1, -1)
    for names in chain.from_iterable(combinations(items, size) for size in sizes):
        yield {name: items[name] for name in names}


def _sum(path: Path) -> str:
    if path.suffix == ".parquet":
        return table_hash(read_parquet(path))
    return hashlib.sha256(path.read_bytes()).hexdigest()
