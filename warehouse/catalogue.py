"""The list of all records: read from ``_index``, plus what was committed since.

The index is one Parquet file per kind with a copy of every catalogue row. It may be
deleted at any time: whoever opens the store next writes it again. It is only a copy, so
a record that is not in it, or no longer on disk, is judged by its folder. Of two that
write it at once the later wins, and what only the other knew is read from its record.
"""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc

from residual.errors import InputError
from warehouse.files import read_parquet, read_unsummed, replace_file, sweep_staging
from warehouse.layout import list_folders
from warehouse.remote import fetch_index, put_index
from warehouse.schema import INDEX, KINDS, Kind

# So many rows may be outside of the catalogue files before who reads them adds them:
# reading one costs a millisecond, writing all of them as much as reading some dozens.
_SPARE = 32
_AT_ONCE = 16  # records that are read, or fetched from a bucket


@dataclass(frozen=True, eq=False, slots=True)
class Catalogue:
    """All records of a store at one moment."""

    folders: Mapping[str, Mapping[str, str]]  # folder of every record, by kind and id
    rows: Mapping[str, pa.Table]  # catalogue rows by kind, oldest first
    # Messages about records whose row cannot be read, by kind; these are left out.
    damaged: Mapping[str, Sequence[str]]


def read_catalogue(store: Path, before: Catalogue | None = None) -> Catalogue:
    """List a store, and bring its index up to date where that pays.

    Args:
        before: What was read earlier; it is given back if nothing has changed.
    """
    folders = {kind: list_folders(store, kind) for kind in KINDS}
    if before is not None and before.folders == folders:
        return before
    rows, damaged = {}, {}
    for kind in KINDS.values():
        found = _rows(store, kind, folders[kind.name], before)
        rows[kind.name], damaged[kind.name] = found
    return Catalogue(folders, rows, damaged)


def _rows(
    store: Path, kind: Kind, folders: Mapping[str, str], before: Catalogue | None
) -> tuple[pa.Table, tuple[str, ...]]:
    """Return the rows of a kind, and messages about those that cannot be read."""
    listed = before.rows[kind.name] if before else _read_index(store, kind)
    ids = listed.column(kind.key)
    known = listed.filter(pc.is_in(ids, pa.array(list(folders), pa.string())))
    missing = sorted(folders.keys() - set(known.column(kind.key).to_pylist()))
    if not missing and len(known) == len(listed):
        return listed, ()
    paths = [Path(folders[id], kind.row) for id in missing]
    with ThreadPoolExecutor(_AT_ONCE) as pool:
        read = list(pool.map(lambda path: _read_row(path, kind), paths))
    rows = pa.concat_tables(
        [known, *(row for row in read if isinstance(row, pa.Table))]
    )
    rows = rows.combine_chunks()
    rows = rows.sort_by([("created", "ascending"), (kind.key, "ascending")])
    added, gone = len(rows) - len(known), len(listed) - len(known)
    if before is None and (added > _SPARE or 4 * added >= len(listed) + 1 or gone):
        # A store that one may only read is still read, only slower.
        with suppress(OSError, InputError):
            sweep_staging(store)
            replace_file(store, store / INDEX / f"{kind.name}.parquet", rows)
            put_index(store / INDEX / f"{kind.name}.parquet")
    return rows, tuple(each for each in read if isinstance(each, str))


def _read_row(path: Path, kind: Kind) -> pa.Table | str:
    """Read the columns of one catalogue row that its view has, or return the fault."""
    try:
        table = read_parquet(path)
    except InputError as error:
        return str(error)
    if lacking := sorted(set(kind.fields.names) - set(table.column_names)):
        return (
            f"{path} is of another version: it lacks {', '.join(lacking)}, which every "
            f"record of {kind.name} has. Take its folder out of the store, and make or "
            "import it again."
        )
    return table.select(kind.fields.names).cast(kind.fields)


def _read_index(store: Path, kind: Kind) -> pa.Table:
    # Missing, torn, or of a version with other columns: all of it can be read again.
    path = store / INDEX / f"{kind.name}.parquet"
    with suppress(InputError):
        fetch_index(path)
        table = read_unsummed(path)
        if table.schema.equals(kind.fields):
            return table
    return kind.fields.empty_table()
