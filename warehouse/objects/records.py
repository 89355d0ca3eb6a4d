"""Records into a bucket: files first, the list that makes them a record last.

The order is what makes it safe: a note that the record may come (`listing.note_key`),
its files, and then its list of sums, under the condition that there is none. Before the
last of these nothing is visible; after it everything is. What a kill leaves are objects
that nothing names.
"""

import os
import shutil
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from time import monotonic

from warehouse.kinds import SAMPLES_FILE, SEALED
from warehouse.objects.bucket import Bucket
from warehouse.objects.listing import note_key
from warehouse.objects.mirror import (
    PRIVATE,
    SUMS,
    keep,
    object_key,
    place_of,
    sums_in,
    writable,
)

_AT_ONCE = 8
# A writer that slept for so long writes its note again: it may have been cleared away.
_LONG = 3600.0


def upload(folder: Path, target: Path) -> bool:
    """Make a staged folder a record of a bucket, whole or not at all.

    Args:
        folder: The folder, all files and sums written; it is used up.

    Returns:
        Whether it is this one; False if another writer was faster.

    Raises:
        InputError: If the bucket does not answer, or its server ignores conditions.
    """
    store, key = place_of(target)
    bucket, begun = writable(store), monotonic()
    sums = (folder / SUMS).read_bytes()
    objects = _objects(folder, key)
    note = note_key(key)
    with ThreadPoolExecutor(_AT_ONCE) as beside:
        noted = [beside.submit(bucket.put, note, b"")] if note else []
        puts = [beside.submit(_put, bucket, k, p) for k, p in objects.items()]
        for each in (*noted, *puts):
            each.result()
    won = _commit(bucket, f"{key}/{SUMS}", sums)
    if won and note and monotonic() - begun > _LONG:
        bucket.put(note, b"")
    if won:
        _copy(folder, target)
    return won


def upload_file(path: Path, target: Path) -> bool:
    """Put a file by itself into a bucket; one that is there already stays.

    Returns:
        Whether it goes into a bucket; False where its place is in a folder only.

    Raises:
        InputError: If the bucket does not answer, or its server ignores conditions.
    """
    place = place_of(target)
    if place is None:
        return False
    data = path.read_bytes()
    if not writable(place[0]).put_if_absent(place[1], data):
        data = writable(place[0]).get(place[1]) or data
    keep(target, data)
    return True


def _objects(folder: Path, key: str) -> Mapping[str, Path]:
    return {
        object_key(key, name, known["sha256"]): folder / name
        for name, known in sums_in(folder).items()
    }


def _put(bucket: Bucket, key: str, path: Path) -> None:
    bucket.put(key, path.read_bytes())


def _commit(bucket: Bucket, key: str, sums: bytes) -> bool:
    while True:
        if bucket.put_if_absent(key, sums):
            return True
        there = bucket.get(key)
        # None: refused only because another was at it, who then failed. The same: the
        # answer to our own put was lost, and it was sent once more.
        if there is not None:
            return there == sums


def _copy(folder: Path, target: Path) -> None:
    """Keep small files as copies; samples and what is sealed are fetched when read."""
    if target.parent.name == SEALED:
        return
    target.mkdir(PRIVATE, parents=True, exist_ok=True)
    for path in folder.iterdir():
        if path.name != SAMPLES_FILE:
            os.replace(path, target / path.name)
    shutil.rmtree(folder, ignore_errors=True)
