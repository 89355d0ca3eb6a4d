"""The list of all records of a bucket: catalogue files, and a tail of notes.

`_index/heads/<number>.json` names the catalogue files of each kind; the highest number
holds. A new one is written under the condition that its number is free, so of two that
compact at once one begins anew from the other's. Catalogue files never change.

Before a record is committed its writer leaves a note: an empty object with the record's
name under `_index/tail/`. Who lists looks at the tail first and at the head after that,
so a record that is moved from the one to the other meanwhile is seen in one of them. A
note alone is no record: its list of sums must be there too.
"""

import json
import re
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from residual.errors import InputError
from warehouse.ids import check_id, check_slug
from warehouse.kinds import INDEX, KINDS, Kind
from warehouse.objects.bucket import Bucket
from warehouse.objects.mirror import at_hand, bucket_of, is_there, keep

TAIL, HEADS = f"{INDEX}/tail", f"{INDEX}/heads"
FILES = f"{INDEX}/files"
_DIGITS = 10
_AT_ONCE = 16
_NOBODY = "-"  # stands for the robot of what is no run
# Names in a bucket become paths here, so they are what we write, letter by letter.
_NOTE = re.compile(
    rf"{TAIL}/({'|'.join(KINDS)})/([a-z0-9_-]{{1,40}})/([0-9a-f]{{1,20}})"
)
_FILE = re.compile(r"[a-z]+-[0-9a-f]{1,40}")
_FOLDERS = {kind.folder: kind for kind in KINDS.values()}


@dataclass(frozen=True, slots=True)
class Head:
    """What a catalogue consists of.

    Attributes:
        number: Its number; 0 where there is none yet.
        files: Catalogue files of each kind: names, and how many rows each has.
    """

    number: int
    files: Mapping[str, tuple[tuple[str, int], ...]]


@dataclass(frozen=True, slots=True)
class Listing:
    """Which records there are at one moment.

    Attributes:
        head: The catalogue.
        places: Folder of each record in the store, by kind and id.
    """

    head: Head
    places: Mapping[str, Mapping[str, str]]


def note_of(kind: str, id: str, robot: str) -> str:
    """Return the key of the note of a record.

    Args:
        robot: Robot of a run; of other kinds it is not looked at.
    """
    return f"{TAIL}/{kind}/{robot if kind == 'runs' else _NOBODY}/{id}"


def note_key(folder: str) -> str | None:
    """Return the key of the note of a record, None for what is in no list.

    Args:
        folder: Its folder in the store, as samples/robot=arm/run_id=0f.
    """
    top, _, rest = folder.partition("/")
    if top not in _FOLDERS:
        return None
    parts = [part.partition("=")[2] for part in rest.split("/")]
    return note_of(_FOLDERS[top].name, parts[-1], parts[0])


def folder_of(note: str) -> str | None:
    """Return the folder in the store that a note is about, None if it is no note."""
    named = _named(note)
    return named and named[2]


def read_listing(store: Path, kinds: Sequence[str] = tuple(KINDS)) -> Listing:
    """List the records of a store in a bucket.

    Raises:
        InputError: If the bucket does not answer.
    """
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
    """Return the catalogue that holds now.

    Raises:
        InputError: If it is damaged, or the bucket does not answer.
    """
    while heads := bucket.objects(HEADS):
        key = heads[-1].key
        text = bucket.get(key)
        # Cleared away since, by who has written several others.
        if text is not None:
            return parse_head(key, text)
    return Head(0, {})


def head_key(number: int) -> str:
    """Return the key of a head."""
    return f"{HEADS}/{number:0{_DIGITS}}.json"


def head_text(head: Head) -> bytes:
    """Return a head as its object has it."""
    return json.dumps({"schema": 1, "files": head.files}).encode()


def read_rows(store: Path, head: Head, kind: Kind) -> pa.Table:
    """Return the catalogue rows of a kind, each record once.

    Raises:
        InputError: If a catalogue file is missing or damaged.
    """
    tables = [_table(store, name) for name, _ in head.files.get(kind.name, ())]
    tables = [table for table in tables if table.schema.equals(kind.fields)]
    rows = pa.concat_tables([kind.fields.empty_table(), *tables])
    ids = rows.column(kind.key).to_pylist()
    if len(set(ids)) == len(ids):
        return rows
    first = {id: place for place, id in reversed(list(enumerate(ids)))}
    return rows.take(pa.array(sorted(first.values())))


def bring_rows(
    store: Path, records: Sequence[tuple[str, str]], places: Mapping
) -> None:
    """Copy the rows of several records into the mirror, some at a time."""
    paths = [store / places[kind][id] / KINDS[kind].row for kind, id in records]

    def bring(path: Path) -> None:
        try:
            at_hand(path)
        except InputError:
            # Told by who reads it.
            return

    with ThreadPoolExecutor(_AT_ONCE) as beside:
        list(beside.map(bring, paths))


def _places(store: Path, head: Head, kind: Kind) -> list[tuple[str, str]]:
    columns = [kind.key, "robot"] if kind.name == "runs" else [kind.key]
    out = []
    for name, _ in head.files.get(kind.name, ()):
        rows = _table(store, name, columns)
        ids = [check_id(id) for id in rows.column(kind.key).to_pylist()]
        if kind.name == "runs":
            robots = {
                r: check_slug(r) for r in rows.column("robot").unique().to_pylist()
            }
            bases = [
                f"{kind.folder}/robot={robots[r]}" for r in rows["robot"].to_pylist()
            ]
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
            raise InputError(
                f"The catalogue file {name} is missing. Make the catalogue again: "
                "modelgap compact."
            )
        keep(path, data)
    try:
        return pq.read_table(path, columns=columns, partitioning=None)
    except (pa.ArrowException, OSError) as error:
        path.unlink(missing_ok=True)
        raise InputError(
            f"The catalogue file {name} is damaged. Try again, and if that does not "
            "help, make the catalogue anew: modelgap compact."
        ) from error


def parse_head(key: str, text: bytes) -> Head:
    """Return a head from its object.

    Raises:
        InputError: If it is damaged.
    """
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
        raise InputError(
            f"{key} in the bucket is damaged. Make the catalogue again: modelgap "
            "compact."
        ) from error


def _named(note: str) -> tuple[str, str, str] | None:
    """Return kind, id and folder of the record that a note is about."""
    found = _NOTE.fullmatch(note)
    if found is None:
        return None
    name, robot, id = found.groups()
    kind = KINDS[name]
    base = kind.folder if robot == _NOBODY else f"{kind.folder}/robot={robot}"
    return name, id, f"{base}/{kind.key}={id}"
