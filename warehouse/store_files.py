"""Files of the store: Parquet, check sums, and atomic commits by rename.

The one integrity scheme: ``_sums.json`` of every record has the SHA-256 of each of its
files and of itself. Every reader and ``verify`` compare the files with it.
"""

import errno
import hashlib
import json
import os
import shutil
import time
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from residual.errors import InputError
from warehouse.record_ids import (
    SUMS,
    build_damage_error,
    format_check_sums,
    hash_arrays,
    hash_values,
    read_local_sums,
)
from warehouse.remote_store import (
    PRIVATE,
    check_store_folder,
    fetch_file,
    fetch_record,
    find_bucket_key,
    find_store_bucket,
    open_bucket_for_writing,
    upload_file,
    upload_record,
)
from warehouse.view_schema import SEALED, STAGING

Array = np.ndarray

_PRIVATE_FILE = 0o600
_READ_ONLY = (errno.EROFS, errno.EACCES, errno.EPERM)
_WIDTHS = b"modelgap.widths"


def write_check_sums(folder: Path) -> None:
    """Write the sums of all files of a folder into it."""
    sums = {}
    for path in sorted(p for p in folder.iterdir() if p.is_file() and p.name != SUMS):
        data = path.read_bytes()
        sha256 = hashlib.sha256(data).hexdigest()
        sums[path.name] = {"bytes": len(data), "sha256": sha256}
    (folder / SUMS).write_bytes(format_check_sums(sums))


def read_check_sums(folder: Path) -> Mapping[str, Mapping]:
    """Return the sums of a folder's files by name."""
    fetch_file(folder / SUMS)
    try:
        return read_local_sums(folder)
    except FileNotFoundError as error:
        raise build_damage_error(folder / SUMS, "it is missing") from error


def verify_file(path: Path) -> None:
    """Check a file against the sums beside it; InputError if it is not as it was written."""
    sums = read_check_sums(path.parent)
    fetch_file(path)
    if fault := _fault(path, sums):
        raise build_damage_error(path, fault)


def find_damaged_record_files(folder: Path) -> tuple[str, ...]:
    """Return the faults of the files of a record, a line each."""
    try:
        fetch_record(folder)
        sums = read_check_sums(folder)
    except InputError as error:
        return (str(error),)
    names = sorted({*sums, *(path.name for path in folder.iterdir())} - {SUMS})
    faults = ((name, _fault(folder / name, sums)) for name in names)
    return tuple(f"{name}: {fault}" for name, fault in faults if fault)


def _fault(path: Path, sums: Mapping[str, Mapping]) -> str | None:
    if path.name not in sums:
        return f"it is not in {SUMS}"
    size, expected = sums[path.name]["bytes"], sums[path.name]["sha256"]
    try:
        with path.open("rb") as file:
            if os.fstat(file.fileno()).st_size != size:
                return f"it had {size} bytes when it was written"
            if hashlib.file_digest(file, "sha256").hexdigest() != expected:
                return "its bytes are not those that were written"
    except FileNotFoundError:
        return "it is missing"
    except OSError as error:
        return error.strerror or str(error)
    return None


def write_parquet(path: Path, table: pa.Table) -> None:
    """Write a table: zstd; floats split by byte and without a dictionary.

    For measured signals that is half the size of the default and faster both ways.
    """
    pq.write_table(table, path, **choose_parquet_options(table.schema))


def choose_parquet_options(schema: pa.Schema) -> dict:
    """Return how a table of a schema is written."""
    floats, other = [], []
    for field in schema:
        if pa.types.is_floating(field.type):
            floats.append(field.name)
        elif not pa.types.is_nested(field.type):
            other.append(field.name)
    return {
        "compression": "zstd",
        "use_dictionary": other,
        "column_encoding": dict.fromkeys(floats, "BYTE_STREAM_SPLIT"),
    }


def read_parquet(path: Path, columns: list[str] | None = None) -> pa.Table:
    """Read a file of a record, checked against its sums."""
    verify_file(path)
    return read_unverified_parquet(path, columns)


def read_unverified_parquet(path: Path, columns: list[str] | None = None) -> pa.Table:
    """Read a file without sums, such as those of ``_index``."""
    try:
        with pq.ParquetFile(path) as file:
            return file.read(columns=columns)
    except (pa.ArrowException, OSError) as error:
        raise build_damage_error(path, error) from error


def read_row_text(row: Path, column: str) -> str | None:
    """Return a text of a record's one catalogue row."""
    return read_parquet(row, [column]).column(column)[0].as_py()


def arrays_to_table(arrays: Mapping[str, Array], units: Mapping[str, str]) -> pa.Table:
    """Return arrays (n,) or (n, k) as a table: name, or name1, name2, ... for several columns."""
    fields, columns, widths = [], [], {}
    rows = {name: np.shape(array)[:1] for name, array in arrays.items()}
    if len(set(rows.values())) > 1:
        raise InputError(f"Channels differ in their number of samples: {rows}.")
    for name, array in arrays.items():
        values = np.asarray(array, dtype=float)
        if values.ndim not in (1, 2):
            raise InputError(f"{name} has shape {values.shape}, expected (n,) or (n, k).")
        widths[name] = values.shape[1] if values.ndim == 2 else None
        metadata = {"unit": units.get(name, "")}
        parts = [("", values)] if values.ndim == 1 else enumerate(values.T, 1)
        for number, part in parts:
            fields.append(pa.field(f"{name}{number}", pa.float64(), metadata=metadata))
            columns.append(pa.array(part))
    schema = pa.schema(fields, metadata={_WIDTHS: json.dumps(widths)})
    return pa.table(columns, schema=schema)


def table_to_arrays(table: pa.Table) -> dict[str, Array]:
    """Return the arrays of a table of `arrays_to_table`."""
    widths = json.loads((table.schema.metadata or {}).get(_WIDTHS, b"{}"))
    arrays = {}
    for name, width in widths.items():
        if width is None:
            arrays[name] = table.column(name).to_numpy()
        else:
            names = [f"{name}{k}" for k in range(1, width + 1)]
            arrays[name] = np.column_stack([table.column(c).to_numpy() for c in names])
    return arrays


def hash_table(table: pa.Table) -> str:
    """Return the SHA-256 of a table's names and values, 64 hex digits."""
    parts = []
    for name, column in zip(table.column_names, table.columns, strict=True):
        values = column.combine_chunks()
        if pa.types.is_floating(values.type):
            # Null and NaN are the same in numpy, so nulls are hashed separately.
            numbers = values.to_numpy(zero_copy_only=False)
            nulls = values.is_null().to_numpy(zero_copy_only=False)
            parts.append([name, hash_arrays({"values": numbers, "nulls": nulls})])
        else:
            parts.append([name, values.to_pylist()])
    return hash_values(parts)


class ReadOnlyStoreError(InputError, PermissionError):
    """The store is read-only."""


@contextmanager
def create_staging_folder(store: Path, label: str) -> Iterator[Path]:
    """Yield a new folder in ``_staging``, which is removed afterwards.

    Raises:
        InputError: If the folder has other files and is no store.
        ReadOnlyStoreError: If it cannot be written.
    """
    name = f"{label}.{os.getpid()}.{uuid.uuid4().hex[:8]}"
    folder = store / STAGING / name
    if find_store_bucket(store):
        open_bucket_for_writing(store)
    try:
        if store.exists():
            check_store_folder(store)
        else:
            store.mkdir(PRIVATE, parents=True, exist_ok=True)
        folder.mkdir(parents=True)
    except OSError as error:
        if error.errno not in _READ_ONLY:
            raise
        raise ReadOnlyStoreError(
            f"The store {store} is read-only here ({error.strerror}). Nothing was "
            "written. Choose another store: --store FOLDER."
        ) from error
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def publish_folder(folder: Path, target: Path) -> bool:
    """Commit a staged folder by renaming it into place.

    A rename is atomic and fails if the target is not empty: after any kill the record is
    visible completely or not at all, and of two writers of one id one wins. Files and
    folders are synced before and after, so that the order survives a loss of power.

    Returns:
        Whether this writer committed it; False if another one did before.
    """
    write_check_sums(folder)
    if find_bucket_key(target):
        return upload_record(folder, target)
    if target.parent.name == SEALED:
        # Only the owner may read or list hidden halves.
        for path in folder.iterdir():
            path.chmod(_PRIVATE_FILE)
        folder.chmod(PRIVATE)
        _make_folders(target.parent)
        # Another user's folder in a shared store keeps its mode.
        with suppress(PermissionError):
            target.parent.chmod(PRIVATE)
    for path in folder.iterdir():
        flush_to_disk(path)
    flush_to_disk(folder)
    _make_folders(target.parent)
    try:
        os.rename(folder, target)
    except OSError:
        if target.is_dir():
            return False
        raise
    flush_to_disk(target.parent)
    return True


def replace_file(store: Path, target: Path, content: bytes | pa.Table) -> None:
    """Write a file, or a new version of it, by rename."""
    with create_staging_folder(store, target.name) as folder:
        path = folder / target.name
        if isinstance(content, pa.Table):
            write_parquet(path, content)
        else:
            path.write_bytes(content)
        if upload_file(path, target):
            return
        flush_to_disk(path)
        _make_folders(target.parent)
        os.replace(path, target)
        flush_to_disk(target.parent)


def sweep_staging(store: Path, age: float = 86400.0) -> None:
    """Remove staging folders of writers that were killed over `age` seconds ago."""
    oldest = time.time() - age
    for folder in (store / STAGING).glob("*"):
        # Already removed is fine.
        with suppress(OSError):
            if folder.stat().st_mtime < oldest:
                shutil.rmtree(folder, ignore_errors=True)


def flush_to_disk(path: Path) -> None:
    """Wait until a file or folder is on the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _make_folders(folder: Path) -> None:
    """Create a folder and its parents, each synced to disk."""
    if folder.is_dir():
        return
    _make_folders(folder.parent)
    folder.mkdir(exist_ok=True)
    flush_to_disk(folder.parent)
