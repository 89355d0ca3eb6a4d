"""Catalogue rows that writers leave for the index, many in one file.

Opening thousands of one-row files is what a first look at a large store would cost. So
a process that commits keeps its rows and writes them to ``_index`` together. They are
copies: what a kill takes is read from the records themselves.
"""

import atexit
import os
import threading
import uuid
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import pyarrow as pa

from residual.errors import InputError
from warehouse.files import read_parquet, write_parquet
from warehouse.layout import INDEX, Kind

# So many rows in one file: writing it costs what one commit does, once in so many.
SIZE = 64

_waiting: dict[tuple[str, str], list[pa.Table]] = {}
_lock = threading.Lock()


def remember(store: Path, kind: Kind, row: pa.Table) -> None:
    """Keep the catalogue row of a record that is committed now.

    Args:
        store: The store.
        kind: Its kind.
        row: Its row; columns beyond those of the catalogue are left out.
    """
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


def read_segments(store: Path, kind: Kind) -> tuple[list[pa.Table], list[Path]]:
    """Return what writers left, and the files it is in; what is torn is no loss.

    Args:
        store: The store.
        kind: Kind of record.
    """
    tables, files = [], sorted((store / INDEX).glob(f"{kind.name}-*.parquet"))
    for file in files:
        with suppress(InputError):
            table = read_parquet(file)
            if table.schema.equals(kind.fields):
                tables.append(table)
    return tables, files


def drop_segments(files: Sequence[Path]) -> None:
    """Remove segments whose rows are in the index now."""
    for file in files:
        with suppress(OSError):
            file.unlink()


def _write(key: tuple[str, str], rows: list[pa.Table]) -> None:
    folder = Path(key[0]) / INDEX
    name = f"{key[1]}-{os.getpid()}-{uuid.uuid4().hex[:8]}"
    draft = folder / f".{name}.part"
    # A full disk, or a store that has gone: the commits themselves are done.
    with suppress(OSError):
        folder.mkdir(exist_ok=True)
        write_parquet(draft, pa.concat_tables(rows))
        os.replace(draft, folder / f"{name}.parquet")


def _forget() -> None:
    """Leave the rows of the parent to the parent, after a fork."""
    _waiting.clear()


atexit.register(flush)
os.register_at_fork(after_in_child=_forget)
