"""Where things are in a store, and how an id is found there without any index."""

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from residual.errors import InputError
from warehouse.files import read_cell, read_parquet
from warehouse.ids import ID_DIGITS, check_id
from warehouse.remote import (
    bucket_of,
    committed_folders,
    has_record,
    names_in,
    store_name,
)
from warehouse.schema import KINDS

RERUN_OF = "rerun of"  # what a record is to the one it was made again from


@dataclass(frozen=True, slots=True)
class StoredRecord:
    """A record that is in the store."""

    kind: str  # name of its kind, such as "runs"
    id: str
    folder: Path

    @property
    def row(self) -> Path:
        """The file with its catalogue row."""
        return self.folder / KINDS[self.kind].row


def list_folders(store: Path, kind: str) -> dict[str, str]:
    """Return the folder of every record of one kind, by id, in the order of ids."""
    if bucket_of(store):
        return committed_folders(store, KINDS[kind].folder)
    prefix = f"{KINDS[kind].key}="
    return dict(sorted(e for b in _bases(store, kind) for e in _entries(b, prefix)))


def find(store: Path, id: str) -> StoredRecord:
    """Find a record of any kind by its id or the beginning of it.

    Raises:
        InputError: If it is not an id, or none or several records begin with it.
    """
    check_id(id)
    found: list[StoredRecord] = []
    for kind in KINDS:
        matches = _matches(store, kind, id)
        found += [StoredRecord(kind, known, Path(folder)) for known, folder in matches]
        if found and len(id) == ID_DIGITS:
            break
    if len(found) == 1:
        return found[0]
    if not found:
        raise InputError(
            f"Nothing in {store_name(store)} has an id that begins with '{id}'. "
            "modelgap runs lists its runs."
        )
    some = ", ".join(f"{f.id} ({f.kind})" for f in found[:4])
    more = f" and {len(found) - 4} more" if len(found) > 4 else ""
    raise InputError(f"'{id}' is the beginning of {some}{more}. Give more digits.")


def find_run(store: Path, id: str) -> StoredRecord:
    """Find a run by its id or the beginning of it."""
    found = find(store, id)
    if found.kind != "runs":
        raise InputError(f"{found.id} is in {found.kind}, expected the id of a run.")
    return found


def read_record(store: Path, id: str) -> dict:
    """Return what a record was committed with; of a run, its manifest."""
    found = find(store, id)
    return json.loads(
        read_cell(found.row, "manifest" if found.kind == "runs" else "record")
    )


def with_parents(store: Path, id: str) -> list[StoredRecord]:
    """Return a record after all that it was made from: parents stand first."""
    order: dict[str, StoredRecord] = {}
    path: set[str] = set()

    def visit(found: StoredRecord) -> None:
        if found.id in order or found.id in path:
            return
        path.add(found.id)
        for id in parents_of(store, found):
            try:
                parent = find(store, id)
            except InputError as error:
                raise InputError(
                    f"{found.id} ({found.kind}) was made from {id}, which is not in "
                    f"{store_name(store)}."
                ) from error
            visit(parent)
        order[found.id] = found

    visit(find(store, id))
    return list(order.values())


def parents_of(store: Path, found: StoredRecord) -> list[str]:
    """Return ids of what a record was made from: its lineage, and what it asked for."""
    rows = read_parquet(found.row, ["lineage"]).column("lineage")[0].as_py() or []
    ids = [row["parent"] for row in rows]
    if found.kind != "runs":
        ids += _ids_in((read_record(store, found.id) or {}).get("request"))
    return list(dict.fromkeys(check_id(id) for id in ids))


def _ids_in(value: object) -> list[str]:
    """Return all whole ids in a request."""
    if isinstance(value, Mapping):
        return [id for item in value.values() for id in _ids_in(item)]
    if isinstance(value, list):
        return [id for item in value for id in _ids_in(item)]
    whole = isinstance(value, str) and len(value) == ID_DIGITS
    return [value] if whole and not set(value) - set("0123456789abcdef") else []


def _matches(store: Path, kind: str, id: str) -> list[tuple[str, str]]:
    if len(id) < ID_DIGITS:
        return [e for e in list_folders(store, kind).items() if e[0].startswith(id)]
    # A whole id needs no listing: its path is known but for the robot.
    known, bases = KINDS[kind], _bases(store, kind)
    paths = [os.path.join(base, f"{known.key}={id}") for base in bases]
    return [(id, path) for path in paths if has_record(Path(path))]


def _bases(store: Path, kind: str) -> list[str]:
    """Return the folders that hold the records of a kind."""
    folder = KINDS[kind].folder
    if kind != "runs":
        return [str(store / folder)]
    robots = (name for name in names_in(store, folder) if name.startswith("robot="))
    return [str(store / folder / name) for name in robots]


def _entries(folder: str, prefix: str) -> list[tuple[str, str]]:
    """What follows the prefix, and the path, of every such entry of a folder."""
    try:
        with os.scandir(folder) as entries:
            return [
                (entry.name[len(prefix) :], entry.path)
                for entry in entries
                if entry.name.startswith(prefix)
            ]
    except FileNotFoundError:
        return []
