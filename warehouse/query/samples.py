"""The samples of runs for SQL: one Arrow dataset, checked as it is read.

Every page of a Parquet file has a checksum, which Arrow verifies where it is told to;
DuckDB's own reader looks at none. The footer has none: its hash is in the sums of the
record, and is held against the file before the first query about samples. Filters and
columns of a query reach the files, so that one over one run reads that run.
"""

import os
from collections.abc import Mapping
from functools import lru_cache, partial
from io import BytesIO
from pathlib import Path

import pyarrow.dataset as ds
from pyarrow.fs import FileSystem, FSSpecHandler, LocalFileSystem, PyFileSystem

from residual.errors import InputError
from warehouse.bucket import Bucket
from warehouse.files import check_file, check_footer, footer_hash
from warehouse.remote import bucket_of, object_of
from warehouse.schema import SAMPLES_FILE, arrow_schema, sample_columns
from warehouse.sums import damaged

_CHECKED = ds.ParquetFileFormat(
    default_fragment_scan_options=ds.ParquetFragmentScanOptions(
        page_checksum_verification=True
    )
)


class Samples:
    """The samples of the runs of one store."""

    def __init__(self, store: Path) -> None:
        self._store = store
        self._files: FileSystem = LocalFileSystem()
        self._whole: dict[str, tuple] = {}
        self._folders: Mapping[str, str] = {}
        self._remote = bucket_of(store) is not None
        if self._remote:
            self._files = _objects()

    def dataset(self, folders: Mapping[str, str], dof: int) -> ds.Dataset:
        """Return the samples of runs; no file is opened for it.

        Args:
            folders: Folder of each run, by id.
            dof: Number of joints that the columns are for.
        """
        self._folders = folders
        fragments = [
            _CHECKED.make_fragment(
                f"{folder}/{SAMPLES_FILE}",
                self._files,
                (ds.field("robot") == Path(folder).parent.name.partition("=")[2])
                & (ds.field("run_id") == id),
            )
            for id, folder in folders.items()
        ]
        schema = arrow_schema(sample_columns(dof))
        return ds.FileSystemDataset(fragments, schema, _CHECKED, self._files)

    def footers(self) -> dict[str, str]:
        """Return what is wrong with the ends of files, by run; each is read once.

        Of a store in a bucket a file shows it when it is opened.
        """
        found = {}
        for id, folder in {} if self._remote else self._folders.items():
            path = Path(folder, SAMPLES_FILE)
            try:
                state = os.stat(path)
                key = (state.st_ino, state.st_size, state.st_mtime_ns)
                if self._whole.get(id) != key:
                    check_footer(path)
                    self._whole[id] = key
            except OSError as error:
                found[id] = str(damaged(path, error.strerror))
            except InputError as error:
                found[id] = str(error)
        return found

    def broken(self) -> dict[str, str]:
        """Read all files; returns what is damaged, by run. For an answer that failed.

        Arrow does not say in which file a checksum does not fit.
        """
        found = {}
        for id, folder in self._folders.items():
            try:
                check_file(Path(folder, SAMPLES_FILE))
            except InputError as error:
                found[id] = str(error)
        return found


def _objects() -> FileSystem:
    # Late: its library is a slow import, and of no use to a store in a folder.
    from fsspec import AbstractFileSystem

    class Objects(AbstractFileSystem):
        """Samples in a bucket by their path here: nothing else is reached."""

        protocol, cachable = "modelgap", False
        _place = staticmethod(lru_cache(1)(object_of))

        def info(self, path: str, **_: object) -> dict:
            known = self._place(Path(path))[2]
            return {"name": path, "size": known["bytes"], "type": "file"}

        def _open(self, path: str, mode: str = "rb", **_: object) -> "Ranges":
            return Ranges(path, *self._place(Path(path)))

    return PyFileSystem(FSSpecHandler(Objects()))


class Ranges(BytesIO):
    """A file in a bucket, of which parts are fetched as they are read."""

    def __init__(self, path: str, bucket: Bucket, key: str, known: Mapping) -> None:
        super().__init__()
        self._size, self._at = known["bytes"], 0
        self._fetch = partial(bucket.get_range, key)
        length, expected = known.get("footer") or (self._size, known["sha256"])
        self._first = self._size - length
        self._tail = self._fetch(self._first, self._size)
        if footer_hash(self._tail) != expected:
            raise damaged(Path(path), "its end is not what was written")

    def seek(self, offset: int, whence: int = 0) -> int:
        """Go to a place (`io.BytesIO.seek`)."""
        self._at = offset + (0, self._at, self._size)[whence]
        return self._at

    def tell(self) -> int:
        """Return the place."""
        return self._at

    def read(self, size: int | None = -1) -> bytes:
        """Return bytes from the place on (`io.BytesIO.read`)."""
        start = self._at
        end = self._size if size is None or size < 0 else min(start + size, self._size)
        self._at = max(start, end)
        if start >= self._first:
            return self._tail[start - self._first : max(end - self._first, 0)]
        return self._fetch(start, end) if start < end else b""
