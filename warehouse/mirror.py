"""The folder of this machine beside a store on object storage, and records into it.

Every part of the program takes a store as a folder. Of a store in a bucket that folder
is a mirror: it holds copies of what was read, what is being written, and what makes no
sense in a bucket, such as Prefect's database and lock files. Nothing in the bucket is
ever changed, so a copy is right for ever, and deleting a mirror loses nothing but what
Prefect remembers.

A file of a record lies in the bucket under a key with its hash in it, and its list of
sums, which is written last, says which that is. So two writers of one record never
write into each other's files, whatever is in them.

The order is what makes a commit safe: a note that the record may come (`note_key`), its
files, and then its list of sums, under the condition that there is none. Before the
last of these nothing is visible; after it everything is. What a kill leaves are objects
that nothing names.

Whatever asks the bucket raises InputError where it does not answer, or gives what is
damaged.
"""

import hashlib
import json
import os
import shutil
import uuid
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import lru_cache
from pathlib import Path, PurePosixPath
from time import monotonic

from residual.errors import InputError
from warehouse.bucket import Bucket, endpoint_url, open_bucket, parse
from warehouse.schema import (
    FOLDERS,
    INDEX,
    KINDS,
    QUARANTINE,
    SAMPLES_FILE,
    SEALED,
    STAGING,
)

IDENTITY = "_store.json"
TAIL = f"{INDEX}/tail"
NOBODY = "-"  # stands for the robot of what is no run
_FOLDERS = {kind.folder: kind for kind in KINDS.values()}
_FORM = 1
_AT_ONCE = 8
# A writer that slept for so long writes its note again: it may have been cleared away.
_LONG = 3600.0

CACHE = "MODELGAP_CACHE"
SUMS = "_sums.json"
PRIVATE = 0o700
# What lies in the bucket by its own name, and not as the file of a record.
_PLAIN = (QUARANTINE, "made_with")
_LOCAL = (STAGING, INDEX, "_prefect")
_open: dict[str, Bucket] = {}
_writable: set[str] = set()


# Which store is at an address, and whether its server keeps conditions.
#
# `_store.json` is the first object of a store. It is written under the condition that
# it is not there, twice: a server that takes both ignores the condition, and would let
# two writers of one record believe that they were first. Such servers exist; nothing is
# written to them.


def identity_of(bucket: Bucket) -> str | None:
    """Return the identity of the store in a bucket, None where there is no store."""
    text = bucket.get(IDENTITY)
    if text is None:
        return None
    try:
        told = json.loads(text)
        if told["schema"] == _FORM:
            return str(told["store"])
    except (ValueError, KeyError, TypeError):
        pass
    raise InputError(f"{IDENTITY} in the bucket is of no store of this version.")


def make_identity(bucket: Bucket, shown: str) -> str:
    """Make a store in a bucket if there is none, and try its server's condition."""
    told = {"schema": _FORM, "store": uuid.uuid4().hex}
    bucket.put_if_absent(IDENTITY, json.dumps(told).encode())
    text = bucket.get(IDENTITY)
    # The same once more: where it is taken, no harm is done but to our trust.
    if text is None or bucket.put_if_absent(IDENTITY, text):
        raise InputError(
            f"The server of {shown} ignores the condition of a put (If-None-Match): of "
            "eight writers of one record all eight would believe to be the first. "
            f"Nothing but {IDENTITY} was written. Use one that keeps it: AWS S3, "
            "SeaweedFS, MinIO (docs/object_storage.md)."
        )
    identity = identity_of(bucket)
    if identity is None:
        raise InputError(f"{shown} has lost what was written to it a moment ago.")
    return identity


def mirror_of(word: str) -> Path:
    """Return the mirror of the store at s3://...; it is there where the store is."""
    address = parse(word)
    named = f"{endpoint_url() or ''} {address.url}"
    name = f"{address.bucket}-{hashlib.sha256(named.encode()).hexdigest()[:16]}"
    mirror = Path(_root()) / name
    if name not in _open or not mirror.is_dir():
        bucket = open_bucket(address)
        identity = identity_of(bucket)
        _renew(mirror, {"url": address.url, "identity": identity})
        if identity is None:
            # Asked again by the next, since somebody may make it meanwhile.
            return mirror
        _open[name] = bucket
    return mirror


def bucket_of(store: Path) -> Bucket | None:
    """Return the bucket of a store, None for a store that is a folder."""
    if str(store.parent) != _root():
        return None
    if store.name not in _open:
        _open[store.name] = open_bucket(parse(_card(store)["url"]))
    return _open[store.name]


def writable(store: Path) -> Bucket:
    """Return the bucket of a mirror, made a store, and known to keep conditions."""
    bucket = bucket_of(store)
    if str(store) not in _writable:
        identity = make_identity(bucket, shown(store))
        store.mkdir(PRIVATE, parents=True, exist_ok=True)
        _write_card(store, _card(store) | {"identity": identity})
        _writable.add(str(store))
    return bucket


def shown(store: Path) -> str:
    """Return what people call a store: its address, or its folder."""
    return _card(store)["url"] if bucket_of(store) else str(store)


def place_of(path: Path) -> tuple[Path, str] | None:
    """Return mirror and key of a path whose place is in a bucket, None for others."""
    root = _root()
    text = str(path)
    if not text.startswith(root + os.sep):
        return None
    name, _, key = text[len(root) + 1 :].partition(os.sep)
    top = key.partition("/")[0]
    if top in _LOCAL or top not in FOLDERS:
        return None
    return Path(root, name), key


def ensure_local(path: Path) -> None:
    """Copy a file of a store in a bucket into the mirror, if it is not there yet."""
    place = place_of(path)
    if place is None or path.exists():
        return
    store, key = place
    bucket = bucket_of(store)
    if key.partition("/")[0] in _PLAIN or path.name == SUMS:
        data = bucket.get(key)
    else:
        data = _file_of_record(bucket, path, key)
    if data is not None:
        keep(path, data)


def brought(folder: Path) -> bool:
    """Copy all files of a record into the mirror; whether there is such a record."""
    if place_of(folder) is None:
        return folder.is_dir()
    if not is_there(folder):
        return False
    for name in sums_in(folder):
        ensure_local(folder / name)
    return True


def is_copied(folder: Path) -> bool:
    """Return whether there is a record, of a bucket only if there is a copy here.

    For who is about to commit: the condition of his put asks the bucket.
    """
    return (folder / SUMS).is_file() if place_of(folder) else folder.is_dir()


def is_there(folder: Path) -> bool:
    """Return whether there is a record, with as little as that takes."""
    if place_of(folder) is None:
        return folder.is_dir()
    ensure_local(folder / SUMS)
    return (folder / SUMS).is_file()


def names_in(store: Path, folder: str) -> list[str]:
    """Return the names in a folder of a store, in order; it need not be there."""
    if bucket := bucket_of(store):
        return bucket.names(folder)
    place = store / folder
    return sorted(os.listdir(place)) if place.is_dir() else []


def sums_in(folder: Path) -> Mapping[str, Mapping]:
    """Return the sums of a record's files by name, as the list beside them has them."""
    why: object = "it is not the list that was written"
    try:
        text = (folder / SUMS).read_bytes()
        sums = json.loads(text)["files"]
        if sums_text(sums) == text:
            return sums
    except FileNotFoundError:
        raise
    except OSError as error:
        why = error
    except (ValueError, KeyError, TypeError, RecursionError):
        pass
    raise damaged(folder / SUMS, why)


def sums_text(sums: Mapping) -> bytes:
    """Return a list of sums as its file has it: it ends with its own SHA-256."""
    made = json.dumps(sums, sort_keys=True, separators=(",", ":"))
    own = hashlib.sha256(made.encode()).hexdigest()
    return f'{{"files":{made},"sha256":"{own}"}}\n'.encode()


def damaged(path: Path, what: object) -> InputError:
    """Return the error, in one line, that names a damaged file."""
    text = " ".join(str(what).split())
    return InputError(
        f"{path} is damaged ({text[:120]}). Take its folder out of the store."
    )


def object_key(folder: str, name: str, sha256: str) -> str:
    """Return the key of a record's file: its hash stands before the end of its name."""
    path = PurePosixPath(name)
    return f"{folder}/{path.stem}.{sha256[:16]}{path.suffix}"


def keep(path: Path, data: bytes) -> None:
    """Write a copy, whole or not at all."""
    path.parent.mkdir(PRIVATE, parents=True, exist_ok=True)
    draft = path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}")
    try:
        draft.write_bytes(data)
        os.replace(draft, path)
    finally:
        draft.unlink(missing_ok=True)


def note_of(kind: str, id: str, robot: str) -> str:
    """Return the key of the note of a record; the robot is looked at for runs only."""
    return f"{TAIL}/{kind}/{robot if kind == 'runs' else NOBODY}/{id}"


def note_key(folder: str) -> str | None:
    """Return the key of the note of a record's folder, None for what is in no list."""
    top, _, rest = folder.partition("/")
    if top not in _FOLDERS:
        return None
    parts = [part.partition("=")[2] for part in rest.split("/")]
    return note_of(_FOLDERS[top].name, parts[-1], parts[0])


def upload(folder: Path, target: Path) -> bool:
    """Make a staged folder a record of a bucket, whole or not at all.

    Args:
        folder: The folder, all files and sums written; it is used up.

    Returns:
        Whether it is this one; False if another writer was faster.
    """
    store, key = place_of(target)
    bucket, begun = writable(store), monotonic()
    sums = (folder / SUMS).read_bytes()
    objects = {
        object_key(key, name, known["sha256"]): folder / name
        for name, known in sums_in(folder).items()
    }
    note = note_key(key)

    def put(name: str, path: Path) -> None:
        bucket.put(name, path.read_bytes())

    with ThreadPoolExecutor(_AT_ONCE) as beside:
        noted = [beside.submit(bucket.put, note, b"")] if note else []
        puts = [beside.submit(put, *each) for each in objects.items()]
        for each in (*noted, *puts):
            each.result()
    won = _commit(bucket, f"{key}/{SUMS}", sums)
    if won and note and monotonic() - begun > _LONG:
        bucket.put(note, b"")
    if won:
        _copy(folder, target)
    return won


def upload_file(path: Path, target: Path) -> bool:
    """Put a file by itself into a bucket; False where its place is in a folder."""
    place = place_of(target)
    if place is None:
        return False
    data = path.read_bytes()
    if not writable(place[0]).put_if_absent(place[1], data):
        data = writable(place[0]).get(place[1]) or data
    keep(target, data)
    return True


def _file_of_record(bucket: Bucket, path: Path, key: str) -> bytes | None:
    if not is_there(path.parent):
        return None
    known = sums_in(path.parent).get(path.name)
    if known is None:
        return None
    folder = key.rpartition("/")[0]
    data = bucket.get(object_key(folder, path.name, known["sha256"]))
    if data is None or hashlib.sha256(data).hexdigest() != known["sha256"]:
        what = "is missing" if data is None else "is damaged"
        raise InputError(
            f"{path.name} of {folder} {what} in the bucket. Take that record out of "
            f"it, and {INDEX}; what can be made again is, by the same command."
        )
    return data


def _root() -> str:
    names = (CACHE, "XDG_CACHE_HOME", "HOME")
    return _root_in(*map(os.environ.get, names))


@lru_cache(maxsize=8)
def _root_in(own: str | None, cache: str | None, home: str | None) -> str:
    place = own or (f"{cache}/modelgap" if cache else f"{home or ''}/.cache/modelgap")
    return str(Path(place).resolve())


def _card(store: Path) -> dict:
    """Return what was noted of a mirror: the address, and which store was there."""
    try:
        return json.loads(store.with_name(f"{store.name}.json").read_bytes())
    except (OSError, ValueError) as error:
        raise InputError(f"{store} is the mirror of no store.") from error


def _write_card(store: Path, card: Mapping) -> None:
    keep(store.with_name(f"{store.name}.json"), json.dumps(card).encode())


def _renew(mirror: Path, card: Mapping) -> None:
    """Forget copies of another store that was at the same address before."""
    try:
        known = _card(mirror)
    except InputError:
        known = {}
    if known == card:
        return
    if known.get("identity") or card["identity"] is None:
        for name in {INDEX, *_PLAIN, "robots", "sealed"} | {
            kind.folder for kind in KINDS.values()
        }:
            shutil.rmtree(mirror / name, ignore_errors=True)
    with suppress(OSError):
        (mirror / STAGING).rmdir()
    with suppress(OSError):
        mirror.rmdir()
    if card["identity"]:
        mirror.mkdir(PRIVATE, parents=True, exist_ok=True)
    _write_card(mirror, card)


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


def forget() -> None:
    """Ask again for every bucket, as a new process does."""
    _open.clear()
    _writable.clear()


os.register_at_fork(after_in_child=forget)
