"""Records of a store on object storage: committed by one put, fetched to be read.

Every part of the program takes a store as a folder. Of a store in a bucket that is a
folder of this machine: for what is being written, what was fetched to be read, and what
makes no sense in a bucket, such as Prefect's database. What is committed never changes,
so what was fetched is right for ever and may be deleted.

A record is there where `commits/<its folder>.json` is, which is its list of sums: it is
put last, if there is none; what a kill leaves before are objects that nothing names.
The hash of a file is in its key: two writers of one record share no file.

What asks the bucket raises InputError where it does not answer, or gives other bytes.
"""

import hashlib
import json
import os
import re
import shutil
import uuid
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path, PurePosixPath

from residual.errors import InputError
from warehouse.bucket import Bucket, endpoint_url, open_bucket, parse_address
from warehouse.schema import FOLDERS, INDEX, QUARANTINE
from warehouse.sums import SUMS, sums_in

IDENTITY, COMMITS, CACHE = "_store.json", "commits", "MODELGAP_CACHE"
PRIVATE = 0o700
_FORM = 2
_AT_ONCE = 8
# What lies in the bucket by its own name, and not as the file of a record.
_PLAIN = (QUARANTINE, "made_with")
# Names in a bucket become paths here, so they are what we write, letter by letter.
_RECORD = re.compile(r"[a-z]+(/robot=[a-z0-9_-]{1,40})?/[a-z0-9_]+=[0-9a-f]{1,64}")
_THERE = {name for name in FOLDERS if not name.startswith("_")}
_open: dict[str, Bucket] = {}
_writable: set[str] = set()
_real = lru_cache(os.path.realpath)


def identity_of(bucket: Bucket) -> str | None:
    """Return the identity of the store in a bucket, None where there is no store."""
    text = bucket.get(IDENTITY)
    with suppress(ValueError, KeyError, TypeError):
        known = json.loads(text or b"null")
        if known is None or known["schema"] == _FORM:
            return known and str(known["store"])
    raise InputError(f"{IDENTITY} in the bucket is of no store of this version.")


def local_folder(word: str) -> Path:
    """Return the folder here of the store at s3://...; it is there if the store is."""
    bucket, prefix = parse_address(word)
    named = f"{endpoint_url() or ''} {bucket}/{prefix}"
    name = f"{bucket}-{hashlib.sha256(named.encode()).hexdigest()[:16]}"
    folder = Path(_root()) / name
    if name not in _open or not folder.is_dir():
        attach(folder, open_bucket(word))
    return folder


def attach(folder: Path, bucket: Bucket) -> None:
    """Use a folder for a bucket; what it has of another store there is forgotten."""
    before, identity = _card(folder).get("identity"), identity_of(bucket)
    if before not in (None, identity):
        for name in FOLDERS - {"_prefect"}:
            shutil.rmtree(folder / name, ignore_errors=True)
        with suppress(OSError):  # of a store that is gone nothing else is kept
            folder.rmdir()
    _note(folder, bucket, identity)


def bucket_of(store: Path) -> Bucket | None:
    """Return the bucket of a store, None for a store that is a folder."""
    if str(store.parent) != _root():
        return None
    if store.name not in _open:
        _open[store.name] = open_bucket(_card(store).get("url", str(store)))
    return _open[store.name]


def writable(store: Path) -> Bucket:
    """Return the bucket of a folder, made a store, and known to keep conditions.

    A server that takes the same put twice ignores the condition, and would let two
    writers of one record believe that they were first. Such servers exist.
    """
    bucket = bucket_of(store)
    if str(store) not in _writable:
        new = json.dumps({"schema": _FORM, "store": uuid.uuid4().hex}).encode()
        bucket.put_if_absent(IDENTITY, new)
        if bucket.put_if_absent(IDENTITY, bucket.get(IDENTITY) or new):
            raise InputError(
                f"The server of {bucket.url} ignores the condition of a put "
                "(If-None-Match): every writer of a record would be the first. Use one "
                "that keeps it: AWS S3, SeaweedFS, MinIO (docs/store.md)."
            )
        _note(store, bucket, identity_of(bucket))
        _writable.add(str(store))
    return bucket


def store_name(store: Path) -> str:
    """Return what people call a store: its address, or its folder."""
    bucket = bucket_of(store)
    return bucket.url if bucket else str(store)


def bucket_place(path: Path) -> tuple[Path, str] | None:
    """Return store and key of a path whose place is in a bucket, None for others."""
    root, text = _root(), str(path)
    if not text.startswith(root + os.sep):
        return None
    name, _, key = text[len(root) + 1 :].partition(os.sep)
    return (Path(root, name), key) if key.partition("/")[0] in _THERE else None


def is_local(folder: Path) -> bool:
    """Return whether there is a record, of a bucket only if its sums were fetched."""
    return (folder / SUMS).is_file() if bucket_place(folder) else folder.is_dir()


def has_record(folder: Path) -> bool:
    """Return whether there is a record, with as little as that takes."""
    fetch_file(folder / SUMS)
    return is_local(folder)


def fetch_record(folder: Path) -> bool:
    """Fetch all files of a record, if it is in a bucket; whether there is one."""
    if bucket_place(folder) and has_record(folder):
        for name in sums_in(folder):
            fetch_file(folder / name)
    return is_local(folder)


def fetch_file(path: Path) -> None:
    """Fetch a file whose place is in a bucket, if it is not here yet."""
    if os.path.exists(path) or (place := bucket_place(path)) is None:
        return
    store, key = place
    bucket, data = bucket_of(store), None
    if path.name == SUMS:
        data = bucket.get(f"{COMMITS}/{key.rpartition('/')[0]}.json")
    elif key.partition("/")[0] in _PLAIN:
        data = bucket.get(key)
    elif has_record(path.parent):
        known = sums_in(path.parent)[path.name]
        key = _object_key(key.rpartition("/")[0], path.name, known)
        data = bucket.get(key)
        if data is None or hashlib.sha256(data).hexdigest() != known["sha256"]:
            what = "is missing" if data is None else "is damaged"
            raise InputError(
                f"{key} {what} in the bucket. Take that record out of {COMMITS}; what "
                "can be made again is, by the same command."
            )
    if data is not None:
        write_local(path, data)


def names_in(store: Path, folder: str) -> list[str]:
    """Return the names in a folder of a store, in order; it need not be there."""
    if bucket := bucket_of(store):
        if folder in (*_PLAIN, INDEX):
            return bucket.names(folder)
        names = bucket.names(f"{COMMITS}/{folder}")
        return [name.removesuffix(".json") for name in names]
    place = store / folder
    return sorted(os.listdir(place)) if place.is_dir() else []


def committed_folders(store: Path, folder: str) -> dict[str, str]:
    """Return the folder of every record in a folder of a bucket, by its id."""
    keys = bucket_of(store).keys(f"{COMMITS}/{folder}")
    found = (key[len(COMMITS) + 1 :].removesuffix(".json") for key in keys)
    records = sorted(each for each in found if _RECORD.fullmatch(each))
    return {each.rpartition("=")[2]: str(store / each) for each in records}


def write_local(path: Path, data: bytes) -> None:
    """Write what was fetched, whole or not at all."""
    path.parent.mkdir(PRIVATE, parents=True, exist_ok=True)
    draft = path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}")
    try:
        draft.write_bytes(data)
        os.replace(draft, path)
    finally:
        draft.unlink(missing_ok=True)


def upload(folder: Path, target: Path) -> bool:
    """Make a staged folder a record of a bucket, whole or not at all.

    Returns:
        Whether it is this one; False if another writer was faster.
    """
    store, key = bucket_place(target)
    bucket, sums = writable(store), (folder / SUMS).read_bytes()

    def put(name: str, known: Mapping) -> None:
        bucket.put(_object_key(key, name, known), (folder / name).read_bytes())

    with ThreadPoolExecutor(_AT_ONCE) as beside:
        list(beside.map(put, *zip(*sums_in(folder).items(), strict=True)))
    commit = f"{COMMITS}/{key}.json"
    while not bucket.put_if_absent(commit, sums):
        there = bucket.get(commit)
        # None: refused only because another was at it, who then failed. The same: the
        # answer to our own put was lost, and it was sent once more.
        if there is not None:
            return there == sums
    return True


def upload_file(path: Path, target: Path) -> bool:
    """Put a file by itself into a bucket; False where its place is in a folder."""
    place = bucket_place(target)
    if place:
        writable(place[0]).put_if_absent(place[1], path.read_bytes())
        fetch_file(target)
    return place is not None


def fetch_index(path: Path) -> None:
    """Fetch a file of the catalogue anew, which others may have written again."""
    if bucket := bucket_of(path.parent.parent):
        path.unlink(missing_ok=True)
        if data := bucket.get(f"{INDEX}/{path.name}"):
            write_local(path, data)


def put_index(path: Path) -> None:
    """Put a file of the catalogue into the bucket, if any."""
    if bucket := bucket_of(path.parent.parent):
        bucket.put(f"{INDEX}/{path.name}", path.read_bytes())


@contextmanager
def fetched_anew(store: Path) -> Iterator[Path]:
    """Give the folder of a store, of one in a bucket one with nothing in it yet."""
    if (bucket := bucket_of(store)) is None:
        yield store
        return
    place = store.with_name(f"{store.name}-{uuid.uuid4().hex}")
    _open[place.name] = bucket
    try:
        yield place
    finally:
        del _open[place.name]
        shutil.rmtree(place, ignore_errors=True)


def _object_key(folder: str, name: str, known: Mapping) -> str:
    path = PurePosixPath(name)
    return f"{folder}/{path.stem}.{known['sha256'][:16]}{path.suffix}"


def _root() -> str:
    home = os.environ.get("XDG_CACHE_HOME") or f"{os.environ.get('HOME', '')}/.cache"
    return _real(os.environ.get(CACHE) or f"{home}/modelgap")


def _card(store: Path) -> dict:
    """Return what was noted of a folder: the address, and which store was there."""
    try:
        return json.loads(store.with_name(f"{store.name}.json").read_bytes())
    except (OSError, ValueError):
        return {}


def _note(folder: Path, bucket: Bucket, identity: str | None) -> None:
    card = json.dumps({"url": bucket.url, "identity": identity}).encode()
    write_local(folder.with_name(f"{folder.name}.json"), card)
    if identity:
        folder.mkdir(PRIVATE, parents=True, exist_ok=True)
    _open[folder.name] = bucket


def forget_buckets() -> None:
    """Ask again for every bucket, as a new process does."""
    _open.clear()
    _writable.clear()


os.register_at_fork(after_in_child=forget_buckets)
