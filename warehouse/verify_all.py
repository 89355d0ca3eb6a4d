"""A whole store, byte for byte: what is still as it was written, and what is not."""

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from residual.errors import ModelgapError
from residual.robot.robot import load_robot
from warehouse.layout import KINDS, QUARANTINE, SEALED, Found, list_folders
from warehouse.origin.made_with import MADE_WITH, check_kept
from warehouse.origin.robots import ROBOTS
from warehouse.seal import open_seal
from warehouse.sums import SUMS, file_faults
from warehouse.verify import faults

_OPEN_TO_OTHERS = 0o077


@dataclass(frozen=True, slots=True)
class Verified:
    """One thing in a store.

    Attributes:
        kind: Kind of record, or the folder of the store that it is in.
        id: Its id, or the name of its file.
        faults: What is not as it was committed, a line each.
        summed: Whether every byte of it was held against a sum; otherwise its values
            were held against the hash in its record, which an earlier version wrote.
    """

    kind: str
    id: str
    faults: tuple[str, ...]
    summed: bool = True


def verify_all(store: Path) -> Iterator[Verified]:
    """Verify every record, seal, robot, patch and tombstone of a store, one by one.

    Args:
        store: The store.
    """
    runs = set()
    for kind in KINDS:
        for id, folder in list_folders(store, kind).items():
            found = Found(kind, id, Path(folder))
            told = faults(found)
            if kind == "runs" and not told:
                runs.add(id)
            yield Verified(kind, id, told, _has_sums(found.folder))
    for folder in _entries(store / SEALED):
        id = folder.name.removeprefix("run_id=")
        # Of a run that is damaged or gone only the bytes of its seal can be verified.
        opened = _told(open_seal, store, id) if id in runs else ()
        yield Verified(SEALED, id, file_faults(folder) or opened, _has_sums(folder))
    for folder in _entries(store / ROBOTS):
        told = file_faults(folder) or _told(_check_robot, folder)
        yield Verified(ROBOTS, folder.name, told, _has_sums(folder))
    for path in _entries(store / MADE_WITH):
        yield Verified(MADE_WITH, path.name, _told(_check_kept, path))
    for path in _entries(store / QUARANTINE):
        yield Verified(QUARANTINE, path.name, _told(_check_tombstone, path))


def open_to_others(store: Path) -> bool:
    """Return whether other users of this machine may look into a store."""
    return bool(store.stat().st_mode & _OPEN_TO_OTHERS)


def _has_sums(folder: Path) -> bool:
    return (folder / SUMS).is_file()


def _entries(folder: Path) -> list[Path]:
    return sorted(folder.iterdir()) if folder.is_dir() else []


def _told(check: Callable, *about: object) -> tuple[str, ...]:
    """Return what a check says against something, whatever is wrong with it."""
    try:
        check(*about)
    except (ModelgapError, OSError, ValueError, KeyError, RecursionError) as error:
        return (" ".join(str(error).split()),)
    return ()


def _check_robot(folder: Path) -> None:
    if load_robot(folder).content_hash != folder.name.removeprefix("sha256="):
        raise ValueError(f"{folder.name} describes another robot than its name says")


def _check_kept(path: Path) -> None:
    check_kept(path.name, path.read_bytes())


def _check_tombstone(path: Path) -> None:
    told = json.loads(path.read_bytes())
    if f"run_id={told['run_id']}.json" != path.name:
        raise ValueError(f"{path.name} is about another run than its name says")
