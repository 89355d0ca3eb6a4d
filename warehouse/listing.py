"""The list of all records of a bucket: catalogue files, and a tail of notes.

`_index/heads/<number>.json` names the catalogue files of each kind; the highest number
holds. A new one is written under the condition that its number is free, so of two that
append at once one begins anew from the other's. Catalogue files never change; small
ones are joined when there are many of one size, so a row is written anew only as often
as the store grows by a factor.

Before a record is committed its writer leaves a note: an empty object with the record's
name under `_index/tail/`. Who lists looks at the tail first and at the head after that,
so a record that is moved from the one to the other meanwhile is seen in one of them. A
note alone is no record: its list of sums must be there too.
"""

import io
import json
import re
import uuid
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from residual.errors import InputError
from warehouse.bucket import Bucket
from warehouse.ids import check_id, check_slug, record_folder
from warehouse.mirror import (
    SUMS,
    TAIL,
    bucket_of,
    ensure_local,
    is_there,
    keep,
    note_of,
)
from warehouse.schema import INDEX, KINDS, Kind

HEADS = f"{INDEX}/heads"
FILES = f"{INDEX}/files"
AGAIN = (
    f"Delete {INDEX} of the bucket while nobody writes: who opens the store next makes "
    "it again."
)
_DIGITS = 10
_AT_ONCE = 16
# Names in a bucket become paths here, so they are what we write, letter by letter.
_NOTE = re.compile(
    rf"{TAIL}/({'|'.join(KINDS)})/([a-z0-9_-]{{1,40}})/([0-9a-f]{{1,20}})"
)
_FILE = re.compile(r"[a-z]+-[0-9a-f]{1,40}")

# So many files of one size are joined; sizes grow by this factor.
_FAN = 8
_SMALLEST = 64
# Heads of before that are kept for those who are reading them.
_HEADS_KEPT = 4
# What nobody can still be at, by the clock of the server.
_OLD_FILE, _OLD_NOTE = timedelta(hours=1), timedelta(days=2)
_TRIES = 40


@dataclass(frozen=True, slots=True)
class Head:
    """What a catalogue consists of."""

    number: int  # its number; 0 where there is none yet
    # Catalogue files of each kind: names, and how many rows each has.
    files: Mapping[str, tuple[tuple[str, int], ...]]


@dataclass(frozen=True, slots=True)
class Listing:
    """Which records there are at one moment."""

    head: Head
    # Folder of each record in the store, by kind and id.
    places: Mapping[str, Mapping[str, str]]


def read_listing(store: Path, kinds: Sequence[str] = tuple(KINDS)) -> Listing:
    """List the records of a store in a bucket."""
    bucket = bucket_of(store)
    notes = [each.key for each in bucket.objects(TAIL)]
    head = read_head(bucket)
    places = {kind: dict(_places(store, head, KINDS[kind])) for kind in kinds}
    noted = [named for note in notes if (named := _named(note))]
    unknown = [
        (kind, id, folder)
        for kind, id, folder in noted
        if kind in places and id not in places[kind]
    ]
    with ThreadPoolExecutor(_AT_ONCE) as beside:
        there = list(beside.map(lambda each: is_there(store / each[2]), unknown))
    for (kind, id, folder), known in zip(unknown, there, strict=True):
        if known:
            places[kind][id] = folder
    return Listing(
        head, {k: dict(sorted(found.items())) for k, found in places.items()}
    )


def listed_ids(store: Path, kind: str) -> dict[str, str]:
    """Return the folder of every record of one kind, by id, in the order of ids."""
    found = read_listing(store, (kind,)).places[kind]
    return {id: str(store / folder) for id, folder in found.items()}


def read_head(bucket: Bucket) -> Head:
    """Return the catalogue that holds now."""
    while heads := bucket.objects(HEADS):
        key = heads[-1].key
        text = bucket.get(key)
        # Cleared away since, by who has written several others.
        if text is not None:
            return parse_head(key, text)
    return Head(0, {})


def _put_head(store: Path, head: Head, rows: Mapping[str, pa.Table]) -> bool:
    """Let a head hold, which has some new rows; False if its number is taken."""
    bucket = bucket_of(store)
    text = json.dumps({"schema": 1, "files": head.files}).encode()
    if not bucket.put_if_absent(f"{HEADS}/{head.number:0{_DIGITS}}.json", text):
        return False
    bucket.delete(_notes(rows))
    _clear(store, bucket, head)
    return True


def read_rows(store: Path, head: Head, kind: Kind) -> pa.Table:
    """Return the catalogue rows of a kind, those of another version left out."""
    tables = [_table(store, name) for name, _ in head.files.get(kind.name, ())]
    tables = [table for table in tables if table.schema.equals(kind.fields)]
    return pa.concat_tables([kind.fields.empty_table(), *tables])


def bring_rows(paths: Sequence[Path]) -> None:
    """Copy the rows of several records into the mirror, some at a time."""

    def bring(path: Path) -> None:
        # Told by who reads it.
        with suppress(InputError):
            ensure_local(path)

    with ThreadPoolExecutor(_AT_ONCE) as beside:
        list(beside.map(bring, paths))


def _places(store: Path, head: Head, kind: Kind) -> list[tuple[str, str]]:
    columns = [kind.key, "robot"] if kind.name == "runs" else [kind.key]
    out = []
    for name, _ in head.files.get(kind.name, ()):
        rows = _table(store, name, columns)
        ids = [check_id(id) for id in rows.column(kind.key).to_pylist()]
        if kind.name == "runs":
            robots = map(check_slug, rows["robot"].to_pylist())
            bases = [f"{kind.folder}/robot={robot}" for robot in robots]
        else:
            bases = [kind.folder] * len(ids)
        pairs = zip(bases, ids, strict=True)
        out += [(id, f"{base}/{kind.key}={id}") for base, id in pairs]
    return out


def _table(store: Path, name: str, columns: list[str] | None = None) -> pa.Table:
    path = store / INDEX / f"{name}.parquet"
    if not path.exists():
        data = bucket_of(store).get(f"{FILES}/{name}.parquet")
        if data is None:
            raise InputError(f"The catalogue file {name} is missing. {AGAIN}")
        keep(path, data)
    try:
        return pq.read_table(path, columns=columns, partitioning=None)
    except (pa.ArrowException, OSError) as error:
        path.unlink(missing_ok=True)
        raise InputError(
            f"The catalogue file {name} is damaged. Try again; if that does not help: "
            f"{AGAIN}"
        ) from error


def parse_head(key: str, text: bytes) -> Head:
    """Return a head from its object."""
    try:
        files = json.loads(text)["files"]
        known = {
            kind: tuple((str(name), int(count)) for name, count in files.get(kind, ()))
            for kind in KINDS
        }
        if not all(_FILE.fullmatch(n) for part in known.values() for n, _ in part):
            raise ValueError(text)
        return Head(int(key.rpartition("/")[2].removesuffix(".json")), known)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{key} in the bucket is damaged. {AGAIN}") from error


def _named(note: str) -> tuple[str, str, str] | None:
    """Return kind, id and folder of the record that a note is about."""
    found = _NOTE.fullmatch(note)
    if found is None:
        return None
    kind, robot, id = found.groups()
    return kind, id, record_folder(Path(), kind, id, robot).as_posix()


def append(store: Path, rows: Mapping[str, pa.Table]) -> bool:
    """Add records to the catalogue of a bucket, and clear their notes away.

    Returns:
        Whether it was done; False where there is no catalogue yet, which only
        `begin` makes, or others were faster again and again.
    """
    bucket = bucket_of(store)
    if not any(map(len, rows.values())):
        return True
    made = {kind: _write(bucket, kind, table) for kind, table in rows.items()}
    for _ in range(_TRIES):
        head = read_head(bucket)
        if not head.number:
            return False
        files = {k: (*head.files.get(k, ()), *made.get(k, ())) for k in KINDS}
        new = Head(head.number + 1, files)
        new = Head(new.number, _joined(store, bucket, new))
        if _put_head(store, new, rows):
            return True
    return False


def still_noted(store: Path, kind: str, rows: pa.Table) -> pa.Table:
    """Return rows whose notes are in the tail: nobody else has added them yet."""
    tail = {each.key for each in bucket_of(store).objects(TAIL)}
    return rows.filter(pa.array([note in tail for note in _notes({kind: rows})]))


def begin(store: Path, rows: Mapping[str, pa.Table]) -> None:
    """Write the first catalogue of a bucket, unless somebody else did meanwhile."""
    bucket = bucket_of(store)
    files = {kind: _write(bucket, kind, table) for kind, table in rows.items()}
    _put_head(store, Head(1, files), rows)


def all_records(store: Path) -> dict[str, dict[str, str]]:
    """Return the folder of every record by kind and id, from the records themselves."""
    bucket, out = bucket_of(store), {}
    for kind in KINDS.values():
        keys = (each.key for each in bucket.objects(kind.folder))
        folders = [k.removesuffix(f"/{SUMS}") for k in keys if k.endswith(f"/{SUMS}")]
        known = {folder.rpartition("=")[2]: folder for folder in sorted(folders)}
        out[kind.name] = dict(sorted(known.items()))
    return out


def _notes(rows: Mapping[str, pa.Table]) -> list[str]:
    out = []
    for kind, table in rows.items():
        ids = table.column(KINDS[kind].key).to_pylist()
        robots = table.column("robot").to_pylist() if kind == "runs" else ids
        pairs = zip(robots, ids, strict=True)
        out += [note_of(kind, id, robot) for robot, id in pairs]
    return out


def _write(bucket: Bucket, kind: str, table: pa.Table) -> tuple[tuple[str, int], ...]:
    if not len(table):
        return ()
    name, file = f"{kind}-{uuid.uuid4().hex}", io.BytesIO()
    pq.write_table(table, file, compression="zstd")
    bucket.put(f"{FILES}/{name}.parquet", file.getvalue())
    return ((name, len(table)),)


def _joined(store: Path, bucket: Bucket, head: Head) -> dict:
    """Return the files of a head, those of one size made one where they are many."""
    out = {}
    for kind, files in head.files.items():
        sizes: dict[int, list[tuple[str, int]]] = {}
        for each in files:
            sizes.setdefault(_size(each[1]), []).append(each)
        kept = list(files)
        for same in sizes.values():
            if len(same) >= _FAN:
                rows = read_rows(store, Head(0, {kind: tuple(same)}), KINDS[kind])
                # Rows of another version are kept as they are.
                if len(rows) == sum(count for _, count in same):
                    kept = [each for each in kept if each not in same]
                    kept += _write(bucket, kind, rows)
        out[kind] = tuple(kept)
    return out


def _size(rows: int) -> int:
    size, most = 0, _SMALLEST
    while rows > most:
        size, most = size + 1, most * _FAN
    return size


def _clear(store: Path, bucket: Bucket, head: Head) -> None:
    """Remove heads, files and notes that nobody needs; what fails is left for later."""
    with suppress(InputError):
        heads = bucket.objects(HEADS)
        bucket.delete([each.key for each in heads[:-_HEADS_KEPT]])
        if head.number % _FAN:
            return
        now, known = heads[-1].modified, [head]
        for each in heads[-_HEADS_KEPT:-1]:
            known.append(parse_head(each.key, bucket.get(each.key) or b"{}"))
        used = {n for h in known for part in h.files.values() for n, _ in part}
        old = [
            each.key
            for each in bucket.objects(FILES)
            if each.key.rpartition("/")[2].removesuffix(".parquet") not in used
            and now - each.modified > _OLD_FILE
        ]
        bucket.delete(old + _dead_notes(store, bucket, now))


def _dead_notes(store: Path, bucket: Bucket, now: datetime) -> list[str]:
    """Return old notes of records that never came."""
    old = [each for each in bucket.objects(TAIL) if now - each.modified > _OLD_NOTE]
    named = [(each.key, known) for each in old if (known := _named(each.key))]
    return [key for key, (*_, folder) in named if not is_there(store / folder)]
