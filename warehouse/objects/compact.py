"""Notes of the tail into catalogue files; who is beaten to it begins anew.

Small files of a kind are joined when there are many of one size, so a row is written
anew only as often as the store grows by a factor.
"""

import io
import uuid
from collections.abc import Mapping
from contextlib import suppress
from datetime import datetime, timedelta
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from residual.errors import InputError
from warehouse.kinds import KINDS
from warehouse.objects.bucket import Bucket
from warehouse.objects.listing import (
    FILES,
    HEADS,
    TAIL,
    Head,
    folder_of,
    head_key,
    head_text,
    note_of,
    parse_head,
    read_head,
    read_rows,
)
from warehouse.objects.mirror import SUMS, bucket_of, is_there

# So many files of one size are joined; sizes grow by this factor.
_FAN = 8
_SMALLEST = 64
# Heads of before that are kept for those who are reading them.
_HEADS_KEPT = 4
# What nobody can still be at, by the clock of the server.
_OLD_FILE, _OLD_NOTE = timedelta(hours=1), timedelta(days=2)
_TRIES = 40


def append(store: Path, rows: Mapping[str, pa.Table]) -> bool:
    """Add records to the catalogue of a bucket, and clear their notes away.

    Returns:
        Whether it was done; False where there is no catalogue yet, which only
        `replace` makes, or others were faster again and again.

    Raises:
        InputError: If the bucket does not answer or may not be written.
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
        if bucket.put_if_absent(head_key(new.number), head_text(new)):
            bucket.delete(_notes(rows))
            _clear(store, bucket, new)
            return True
    return False


def still_noted(store: Path, kind: str, rows: pa.Table) -> pa.Table:
    """Return rows whose notes are in the tail: nobody else has added them yet."""
    tail = {each.key for each in bucket_of(store).objects(TAIL)}
    return rows.filter(pa.array([note in tail for note in _notes({kind: rows})]))


def replace(store: Path, rows: Mapping[str, pa.Table]) -> bool:
    """Write the catalogue of a bucket anew, and clear the notes of its records away.

    Returns:
        Whether it was done; False where somebody else wrote one meanwhile.

    Raises:
        InputError: If the bucket does not answer or may not be written.
    """
    bucket = bucket_of(store)
    # Of a damaged head the number is still known.
    heads = bucket.objects(HEADS)
    number = int(heads[-1].key.rpartition("/")[2].removesuffix(".json")) if heads else 0
    files = {kind: _write(bucket, kind, table) for kind, table in rows.items()}
    new = Head(number + 1, files)
    if not bucket.put_if_absent(head_key(new.number), head_text(new)):
        return False
    bucket.delete(_notes(rows))
    _clear(store, bucket, new)
    return True


def all_records(store: Path) -> dict[str, dict[str, str]]:
    """Return the folder of every record by kind and id, from the records themselves.

    Raises:
        InputError: If the bucket does not answer.
    """
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
    out = []
    for each in bucket.objects(TAIL):
        place = folder_of(each.key)
        if place and now - each.modified > _OLD_NOTE and not is_there(store / place):
            out.append(each.key)
    return out
