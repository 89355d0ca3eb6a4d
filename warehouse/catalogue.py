"""The list of all records: read from ``_index``, plus what was committed since.

The index is one Parquet file per kind with a copy of every catalogue row, and what
writers left since. It may be deleted at any time:
whoever opens the store next writes it again. It is only a copy, so a record that is
not in it, or no longer on disk, is judged by its folder. Of two that write it at once
the later wins, and what only the other knew is read from its record again.

Opening thousands of one-row files is what a first look at a large store would cost. So
a process that commits keeps its rows and writes them to ``_index`` together. They are
copies: what a kill takes is read from the records themselves.
"""

import atexit
import os
import threading
import uuid
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa

from residual.errors import InputError
from warehouse.files import (
    read_parquet,
    read_unsummed,
    replace_file,
    sweep_staging,
    write_parquet,
)
from warehouse.layout import list_folders
from warehouse.remote import bring_file, bring_index, names_in, place_of, put_index
from warehouse.schema import INDEX, KINDS, Kind

# So many rows may be outside of the catalogue files before who reads them adds them:
# reading one costs a millisecond, writing all of them as much as reading some dozens.
_SPARE = 32
_AT_ONCE = 16  # records that are fetched from a bucket
# So many rows in one file: writing it costs what one commit does, once in so many.
SIZE = 64
_waiting: dict[tuple[str, str], list[pa.Table]] = {}
_lock = threading.Lock()


@dataclass(frozen=True, eq=False, slots=True)
class Catalogue:
    """All records of a store at one moment."""

    folders: Mapping[str, Mapping[str, str]]  # folder of every record, by kind and id
    rows: Mapping[str, pa.Table]  # catalogue rows by kind, oldest first
    # Messages about records whose row cannot be read, by kind; these are left out.
    damaged: Mapping[str, Sequence[str]]


def _filled(
    known: pa.Table, kind: Kind, folders: Mapping[str, str]
) -> tuple[pa.Table, tuple[str, ...]]:
    """Return all rows, also those read from records now, and what is damaged."""
    missing = folders.keys() - set(known.column(kind.key).to_pylist())
    new, damaged = [kind.fields.empty_table()], []
    paths = [Path(folders[id], kind.row) for id in missing]
    if paths and place_of(paths[0]):
        with ThreadPoolExecutor(_AT_ONCE) as beside:
            list(beside.map(_try_to_bring, paths))
    for id in sorted(missing):
        try:
            new.append(_read_row(Path(folders[id]) / kind.row, kind))
        except InputError as error:
            damaged.append(str(error))
    rows = pa.concat_tables([known, *new]).combine_chunks()
    rows = rows.sort_by([("created", "ascending"), (kind.key, "ascending")])
    return rows, tuple(damaged)


def _try_to_bring(path: Path) -> None:
    with suppress(InputError):  # who reads it says what is wrong
        bring_file(path)


def _read_row(path: Path, kind: Kind) -> pa.Table:
    """Read the columns of one catalogue row that its view has."""
    table = read_parquet(path)
    lacking = sorted(set(kind.fields.names) - set(table.column_names))
    if lacking:
        raise InputError(
            f"{path} is of another version: it lacks {', '.join(lacking)}, which every "
            f"record of {kind.name} has. Take its folder out of the store, and make or "
            "import it again."
        )
    return table.select(kind.fields.names).cast(kind.fields)


def remember(store: Path, kind: Kind, row: pa.Table) -> None:
    """Keep the catalogue row of a record that is committed now."""
    key = (str(Path(store).resolve()), kind.name)
    with _lock:
        rows = _waiting.setdefault(key, [])
        rows.append(row.select(kind.fields.names))
        ready = _waiting.pop(key) if len(rows) >= SIZE else None
    if ready:
        _write(key, ready)


def flush() -> None:
    """Write what is kept, as at the end of the process."""
    with _lock:
        waiting = dict(_waiting)
        _waiting.clear()
    for key, rows in waiting.items():
        # One record alone is read as fast as a file of one row.
        if len(rows) > 1:
            _write(key, rows)


def _read_segments(store: Path, kind: Kind) -> tuple[list[pa.Table], list[Path]]:
    """Return what writers left, and the files it is in; what is torn is no loss."""
    names = (n for n in names_in(store, INDEX) if n.startswith(f"{kind.name}-"))
    tables, files = [], [store / INDEX / name for name in names]
    for file in files:
        with suppress(InputError):
            bring_index(file)
            table = read_unsummed(file)
            if table.schema.equals(kind.fields):
                tables.append(table)
    return tables, files


def _write(key: tuple[str, str], rows: list[pa.Table]) -> None:
    folder = Path(key[0]) / INDEX
    name = f"{key[1]}-{os.getpid()}-{uuid.uuid4().hex[:8]}"
    draft, target = folder / f".{name}.part", folder / f"{name}.parquet"
    # A full disk, a store that has gone, the end of the process: the commits
    # themselves are done.
    with suppress(OSError, InputError, RuntimeError):
        folder.mkdir(exist_ok=True)
        write_parquet(draft, pa.concat_tables(rows))
        os.replace(draft, target)
        put_index(target)


def forget_waiting() -> None:
    """Leave what is kept to somebody else: after a fork, to the parent."""
    _waiting.clear()


atexit.register(flush)
os.register_at_fork(after_in_child=forget_waiting)


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
    old = before.rows[kind.name] if before else _read_index(store, kind)
    known, merged = _once(old, kind, folders), []
    if len(old) == len(known) == len(folders):
        return old, ()
    gone = len(old) - len(known)
    if len(folders) > len(known) + (_SPARE if before else 0):
        left, merged = _read_segments(store, kind)
        known = _once(pa.concat_tables([known, *left]), kind, folders)
    rows, damaged = _filled(known, kind, folders)
    added = len(rows) - len(old) + gone
    if not added and not gone:
        return old, damaged
    if before is None and (added > _SPARE or 4 * added >= len(old) or gone):
        # A store that one may only read is still read, only slower.
        with suppress(OSError, InputError):
            sweep_staging(store)
            replace_file(store, store / INDEX / f"{kind.name}.parquet", rows)
            put_index(store / INDEX / f"{kind.name}.parquet", merged)
        for file in merged:
            with suppress(OSError):
                file.unlink()
    return rows, damaged


def _once(rows: pa.Table, kind: Kind, folders: Mapping) -> pa.Table:
    """Drop rows of records that are gone, and all but the first of one id."""
    known: set[str] = set()
    keep = []
    for id in rows.column(kind.key).to_pylist():
        keep.append(id in folders and id not in known)
        known.add(id)
    return rows if all(keep) else rows.filter(pa.array(keep, pa.bool_()))


def _read_index(store: Path, kind: Kind) -> pa.Table:
    # Missing, torn, or of a version with other columns: all of it can be read again.
    path = store / INDEX / f"{kind.name}.parquet"
    with suppress(InputError):
        bring_index(path)
        table = read_unsummed(path)
        if table.schema.equals(kind.fields):
            return table
    return kind.fields.empty_table()
