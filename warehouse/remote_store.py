"""Records of a store in a bucket (object storage).

The program sees every store as a folder. The folder of a store in a bucket is on this
machine: it holds what is being written, copies of what was read, and what belongs to no
bucket, such as Prefect's database. Records never change after their commit, so a copy
stays valid; it may be deleted at any time.

Every function that talks to the bucket raises InputError if the bucket does not answer
or returns other bytes than were committed.
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

from residual.errors import InputError, shorten_value
from warehouse.bucket import Bucket, open_bucket, parse_bucket_address, read_endpoint_url
from warehouse.record_ids import SUMS, read_local_sums
from warehouse.view_schema import FOLDERS, INDEX, OPENED, QUARANTINE

IDENTITY, COMMITS, CACHE = "_store.json", "commits", "MODELGAP_CACHE"
PRIVATE = 0o700
_FORM = 2
_AT_ONCE = 8
# Objects in the bucket under a plain name, not files of a record.
_PLAIN = (QUARANTINE, OPENED, "made_with")
# Names in a bucket become local paths, so only names that we write are accepted.
_RECORD = re.compile(r"[a-z]+(/robot=[a-z0-9_-]{1,40})?/[a-z0-9_]+=[0-9a-f]{1,64}")
_THERE = {name for name in FOLDERS if not name.startswith("_")}
_open: dict[str, Bucket] = {}
_writable: set[str] = set()
_real = lru_cache(os.path.realpath)


def read_store_identity(bucket: Bucket) -> str | None:
    """Return the identity of the store in a bucket, None if there is no store."""
    text = bucket.get(IDENTITY)
    with suppress(ValueError, KeyError, TypeError):
        card = json.loads(text or b"null")
        if card is None or card["schema"] == _FORM:
            return card and str(card["store"])
    raise InputError(f"{IDENTITY} in the bucket is of no store of this version.")


def find_local_copy(address: str) -> Path:
    """Return the local folder of the store at s3://...; it exists if the store does."""
    bucket, prefix = parse_bucket_address(address)
    named = f"{read_endpoint_url() or ''} {bucket}/{prefix}"
    name = f"{bucket}-{hashlib.sha256(named.encode()).hexdigest()[:16]}"
    folder = Path(_root()) / name
    if name not in _open or not folder.is_dir():
        attach_bucket(folder, open_bucket(address))
    return folder


def attach_bucket(folder: Path, bucket: Bucket) -> None:
    """Use a folder for a bucket; delete copies of a different store at that address."""
    before, identity = _card(folder).get("identity"), read_store_identity(bucket)
    if before not in (None, identity):
        for name in FOLDERS - {"_prefect"}:
            shutil.rmtree(folder / name, ignore_errors=True)
        with suppress(OSError):  # nothing else of a previous store is kept
            folder.rmdir()
    _note(folder, bucket, identity)


def find_store_bucket(store: Path) -> Bucket | None:
    """Return the bucket of a store, None for a store that is a folder."""
    if str(store.parent) != _root():
        return None
    if store.name not in _open:
        _open[store.name] = open_bucket(_card(store).get("url", str(store)))
    return _open[store.name]


def open_bucket_for_writing(store: Path) -> Bucket:
    """Return the bucket of a store for writing; create the store if there is none.

    Raises:
        InputError: If the server ignores the condition of a put (some do): then two
            writers of one record would both believe that they committed it.
    """
    bucket = find_store_bucket(store)
    if str(store) not in _writable:
        new = json.dumps({"schema": _FORM, "store": uuid.uuid4().hex}).encode()
        bucket.put_if_absent(IDENTITY, new)
        if bucket.put_if_absent(IDENTITY, bucket.get(IDENTITY) or new):
            raise InputError(
                f"The server of {bucket.url} ignores the condition of a put "
                "(If-None-Match), so two writers could overwrite each other. Use one "
                "that honours it: AWS S3, SeaweedFS, MinIO (docs/store.md)."
            )
        _note(store, bucket, read_store_identity(bucket))
        _writable.add(str(store))
    return bucket


def format_store_name(store: Path) -> str:
    """Return the name of a store in messages: its address, or its folder."""
    bucket = find_store_bucket(store)
    return bucket.url if bucket else str(store)


def check_store_folder(folder: Path) -> None:
    """Check that a folder is a store; an empty folder is an empty store."""
    if not folder.is_dir():
        raise InputError(
            f"There is no store at {format_store_name(folder)}. Make one with modelgap "
            "experiment or demo, or name its folder: --store FOLDER."
        )
    # Hidden files, such as .gitkeep, do not matter.
    names = {name for name in os.listdir(folder) if not name.startswith(".")}
    if names and not names & FOLDERS and not find_store_bucket(folder):
        example = min(names)
        raise InputError(
            f"{folder} is no store: expected folders such as samples or models, got "
            f"'{shorten_value(example)}'"
            f"{f' and {len(names) - 1} more' if len(names) > 1 else ''}. Give the "
            "folder of a store, or a new one: --store FOLDER."
        )


def find_bucket_key(path: Path) -> tuple[Path, str] | None:
    """Return store and key of a path whose place is in a bucket, None for others."""
    root, text = _root(), str(path)
    if not text.startswith(root + os.sep):
        return None
    name, _, key = text[len(root) + 1 :].partition(os.sep)
    return (Path(root, name), key) if key.partition("/")[0] in _THERE else None


def is_record_local(folder: Path) -> bool:
    """Return whether a record is here; of a bucket, whether its sums were fetched."""
    return (folder / SUMS).is_file() if find_bucket_key(folder) else folder.is_dir()


def record_exists(folder: Path) -> bool:
    """Return whether a record exists; of a bucket this fetches its sums at most."""
    fetch_file(folder / SUMS)
    return is_record_local(folder)


def fetch_record(folder: Path) -> bool:
    """Fetch all files of a record in a bucket; return whether the record exists."""
    if find_bucket_key(folder) and record_exists(folder):
        for name in read_local_sums(folder):
            fetch_file(folder / name)
    return is_record_local(folder)


def fetch_file(path: Path) -> None:
    """Fetch a file of a store in a bucket if it is not here yet."""
    if os.path.exists(path) or (place := find_bucket_key(path)) is None:
        return
    store, key = place
    bucket, data = find_store_bucket(store), None
    if path.name == SUMS:
        data = bucket.get(f"{COMMITS}/{key.rpartition('/')[0]}.json")
    elif key.partition("/")[0] in _PLAIN:
        data = bucket.get(key)
    elif record_exists(path.parent):
        sums = read_local_sums(path.parent)[path.name]
        key = _object_key(key.rpartition("/")[0], path.name, sums)
        data = bucket.get(key)
        if data is None or hashlib.sha256(data).hexdigest() != sums["sha256"]:
            problem = "is missing" if data is None else "is damaged"
            raise InputError(
                f"{key} {problem} in the bucket. Remove its record from {COMMITS}; the "
                "command that made it can make it again."
            )
    if data is not None:
        write_local_copy(path, data)


def list_folder_names(store: Path, folder: str) -> list[str]:
    """Return the names in a folder of a store, in order; it need not be there."""
    if bucket := find_store_bucket(store):
        if folder in (*_PLAIN, INDEX):
            return bucket.names(folder)
        names = bucket.names(f"{COMMITS}/{folder}")
        return [name.removesuffix(".json") for name in names]
    place = store / folder
    return sorted(os.listdir(place)) if place.is_dir() else []


def list_committed_folders(store: Path, folder: str) -> dict[str, str]:
    """Return the folder of every record in a folder of a bucket, by its id."""
    keys = find_store_bucket(store).keys(f"{COMMITS}/{folder}")
    folders = (key[len(COMMITS) + 1 :].removesuffix(".json") for key in keys)
    records = sorted(each for each in folders if _RECORD.fullmatch(each))
    return {each.rpartition("=")[2]: str(store / each) for each in records}


def write_local_copy(path: Path, data: bytes) -> None:
    """Write a fetched file by rename, so that no reader sees a part of it."""
    path.parent.mkdir(PRIVATE, parents=True, exist_ok=True)
    draft = path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}")
    try:
        draft.write_bytes(data)
        os.replace(draft, path)
    finally:
        draft.unlink(missing_ok=True)


def upload_record(folder: Path, target: Path) -> bool:
    """Commit a staged folder as a record of a bucket: visible whole or not at all.

    A bucket has no rename, so the commit is one object, ``commits/<folder>.json``: the
    list of sums of the record. Readers look only there; a record without it does not
    exist. The files are put first, each under a key that contains its SHA-256, so two
    writers of one record never overwrite each other's files, and a kill before the last
    put leaves only objects that no commit names. The commit itself is atomic because it
    is a single put with ``If-None-Match: *``: the server accepts it only if no such
    object exists, so exactly one of several writers succeeds. A server that ignores the
    condition is refused (`open_bucket_for_writing`). If the answer to a put is lost,
    the client repeats it and finds its own bytes there, which counts as success.

    Returns:
        Whether this writer committed the record; False if another one did before.
    """
    store, key = find_bucket_key(target)
    bucket, sums = open_bucket_for_writing(store), (folder / SUMS).read_bytes()

    def put(name: str, sums_of_file: Mapping) -> None:
        bucket.put(_object_key(key, name, sums_of_file), (folder / name).read_bytes())

    with ThreadPoolExecutor(_AT_ONCE) as beside:
        list(beside.map(put, *zip(*read_local_sums(folder).items(), strict=True)))
    commit = f"{COMMITS}/{key}.json"
    while not bucket.put_if_absent(commit, sums):
        there = bucket.get(commit)
        # None: the server refused because of a concurrent put that then failed.
        if there is not None:
            return there == sums
    return True


def upload_file(path: Path, target: Path) -> bool:
    """Put a single file into a bucket; return False for a store in a folder."""
    place = find_bucket_key(target)
    if place:
        open_bucket_for_writing(place[0]).put_if_absent(place[1], path.read_bytes())
        fetch_file(target)
    return place is not None


def fetch_index(path: Path) -> None:
    """Fetch a file of the index again: others may have replaced it."""
    if bucket := find_store_bucket(path.parent.parent):
        path.unlink(missing_ok=True)
        if data := bucket.get(f"{INDEX}/{path.name}"):
            write_local_copy(path, data)


def upload_index(path: Path) -> None:
    """Put a file of the index into the bucket, if the store is in one."""
    if bucket := find_store_bucket(path.parent.parent):
        bucket.put(f"{INDEX}/{path.name}", path.read_bytes())


@contextmanager
def open_fresh_copy(store: Path) -> Iterator[Path]:
    """Yield the folder of a store; for a bucket an empty one, without any copies."""
    if (bucket := find_store_bucket(store)) is None:
        yield store
        return
    place = store.with_name(f"{store.name}-{uuid.uuid4().hex}")
    _open[place.name] = bucket
    try:
        yield place
    finally:
        del _open[place.name]
        shutil.rmtree(place, ignore_errors=True)


def _object_key(folder: str, name: str, sums: Mapping) -> str:
    path = PurePosixPath(name)
    return f"{folder}/{path.stem}.{sums['sha256'][:16]}{path.suffix}"


def _root() -> str:
    home = os.environ.get("XDG_CACHE_HOME") or f"{os.environ.get('HOME', '')}/.cache"
    return _real(os.environ.get(CACHE) or f"{home}/modelgap")


def _card(store: Path) -> dict:
    """Return the note on a folder: its address and the identity of its store."""
    try:
        return json.loads(store.with_name(f"{store.name}.json").read_bytes())
    except (OSError, ValueError):
        return {}


def _note(folder: Path, bucket: Bucket, identity: str | None) -> None:
    card = json.dumps({"url": bucket.url, "identity": identity}).encode()
    write_local_copy(folder.with_name(f"{folder.name}.json"), card)
    if identity:
        folder.mkdir(PRIVATE, parents=True, exist_ok=True)
    _open[folder.name] = bucket


def close_buckets() -> None:
    """Forget all open buckets, as a new process would."""
    _open.clear()
    _writable.clear()


os.register_at_fork(after_in_child=close_buckets)
