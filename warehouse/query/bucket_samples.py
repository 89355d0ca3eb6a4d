"""Samples of runs in a bucket for SQL: ranges of them, checked before DuckDB sees them.

DuckDB reads files of Python through fsspec. This file system has nothing but the
samples of the runs of one store, so no query reaches another object, bucket or file.
It reads whole blocks of a run's sums and holds each against its CRC-32; what is in a
bucket never changes, so what was read once is not read again while it fits.
"""

import re
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from threading import Lock

from fsspec import AbstractFileSystem
from fsspec.spec import AbstractBufferedFile

from residual.errors import InputError
from warehouse.files import BLOCK, block_sums, crc
from warehouse.mirror import bucket_of, is_there, object_key, sums_in
from warehouse.schema import SAMPLES_FILE

PROTOCOL = "modelgap"
_HELD = 256 << 20  # bytes of blocks that are held
_FORM = re.compile(
    rf"(samples/robot=[a-z0-9_-]{{1,40}}/run_id=[0-9a-f]{{1,20}})/{SAMPLES_FILE}"
)
# Whatever a file system must say of the age of what never changes.
_ALWAYS = datetime(2020, 1, 1, tzinfo=UTC)


class BucketSamples(AbstractFileSystem):
    """The samples of the runs of one store, as ``modelgap://samples/...``."""

    protocol = PROTOCOL
    cachable = False

    def __init__(self, store: Path) -> None:
        super().__init__()
        self._store, self._bucket = store, bucket_of(store)
        self._blocks: OrderedDict[tuple[str, int], bytes] = OrderedDict()
        self._held, self._lock = 0, Lock()
        self._broken: dict[str, str] = {}

    def forget(self) -> None:
        """Begin anew: what was read so far is of no answer."""
        self._broken.clear()

    def broken(self) -> dict[str, str]:
        """Return what was read and is damaged: a message by the path of the file."""
        return dict(self._broken)

    def glob(self, path: str, **_: object) -> list[str]:
        """Return a path as it is: the views name every file."""
        return [path]

    def exists(self, path: str, **_: object) -> bool:
        """Return whether a path is one of samples."""
        return _FORM.fullmatch(self._strip_protocol(path)) is not None

    isfile = exists

    def modified(self, path: str) -> datetime:
        """Return the same time for all."""
        return _ALWAYS

    def info(self, path: str, **_: object) -> dict:
        """Return name, size and type of a file."""
        _, known = self._known(path)
        return {"name": path, "size": known["bytes"], "type": "file"}

    def _open(self, path: str, mode: str = "rb", **_: object) -> AbstractBufferedFile:
        if mode != "rb":
            raise PermissionError("Samples are read, not written.")
        key, known = self._known(path)
        return _Samples(self, path, key, known)

    def _known(self, path: str) -> tuple[str, Mapping]:
        found = _FORM.fullmatch(self._strip_protocol(path))
        if found is None:
            raise FileNotFoundError(path)
        folder = self._store / found[1]
        if not is_there(folder):
            why = f"The samples of {found[1]} are not in the bucket."
            self._broken[_named(path)] = why
            raise FileNotFoundError(path)
        known = sums_in(folder)[SAMPLES_FILE]
        return object_key(found[1], SAMPLES_FILE, known["sha256"]), known

    def read_blocks(
        self, path: str, key: str, known: Mapping, numbers: Sequence[int]
    ) -> bytes:
        """Return blocks of a file that lie one after the other.

        Raises:
            OSError: If they are not what was written; `broken` says so then.
        """
        with self._lock:
            held = {n: self._blocks.get((key, n)) for n in numbers}
        missing = [n for n, block in held.items() if block is None]
        fetched: dict[int, bytes] = {}
        if missing:
            first, last = missing[0], missing[-1]
            end = min((last + 1) * BLOCK, known["bytes"])
            try:
                data = self._bucket.get_range(key, first * BLOCK, end)
                fetched = _checked(data, first, known)
            except InputError as error:
                self._broken[_named(path)] = str(error)
                raise OSError(str(error)) from error
        with self._lock:
            self._hold(key, fetched)
        return b"".join(fetched.get(n) or held[n] for n in numbers)

    def _hold(self, key: str, fetched: Mapping[int, bytes]) -> None:
        for number, block in fetched.items():
            if (key, number) not in self._blocks:
                self._blocks[key, number] = block
                self._held += len(block)
        while self._held > _HELD:
            _, gone = self._blocks.popitem(last=False)
            self._held -= len(gone)


def _named(path: str) -> str:
    """Return a path as the views have it."""
    return f"{PROTOCOL}://{path.removeprefix(f'{PROTOCOL}://')}"


def _checked(data: bytes, first: int, known: Mapping) -> dict[int, bytes]:
    """Return blocks by their number, each held against its sum."""
    sums, out = block_sums(known), {}
    for place in range(0, len(data), BLOCK):
        number, block = first + place // BLOCK, data[place : place + BLOCK]
        if number >= len(sums) or crc(block) != sums[number]:
            raise InputError(
                f"{SAMPLES_FILE} of a run is damaged in the bucket (its bytes are not "
                "those that were written). modelgap verify says which."
            )
        out[number] = block
    return out


class _Samples(AbstractBufferedFile):
    """One file, for reading from anywhere in it."""

    def __init__(
        self, samples: BucketSamples, path: str, key: str, known: Mapping
    ) -> None:
        # What was read is held by the file system, for all files and queries.
        super().__init__(samples, path, cache_type="none", size=known["bytes"])
        self._key, self._known = key, known

    def _fetch_range(self, start: int, end: int) -> bytes:
        first = start // BLOCK
        numbers = range(first, (end - 1) // BLOCK + 1)
        data = self.fs.read_blocks(self.path, self._key, self._known, numbers)
        return data[start - first * BLOCK : end - first * BLOCK]
