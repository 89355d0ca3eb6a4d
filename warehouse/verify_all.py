"""A whole store, byte for byte: what is still as it was written, and what is not."""

from collections.abc import Iterator
from pathlib import Path

from residual.robot.robot import load_robot
from warehouse.kinds import KINDS, QUARANTINE, SEALED
from warehouse.layout import Found, list_folders
from warehouse.objects.mirror import bucket_of
from warehouse.origin.made_with import MADE_WITH, check_kept
from warehouse.origin.robots import ROBOTS
from warehouse.seal import open_seal
from warehouse.sums import SUMS, file_faults
from warehouse.verified import Verified, check_robot, check_tombstone, told
from warehouse.verify import faults
from warehouse.verify_bucket import verify_bucket

_OPEN_TO_OTHERS = 0o077


def verify_all(store: Path) -> Iterator[Verified]:
    """Verify every record, seal, robot, patch and tombstone of a store, one by one."""
    return verify_bucket(store) if bucket_of(store) else _verify_folder(store)


def _verify_folder(store: Path) -> Iterator[Verified]:
    runs = set()
    for kind in KINDS:
        for id, folder in list_folders(store, kind).items():
            found = Found(kind, id, Path(folder))
            wrong = faults(found)
            if kind == "runs" and not wrong:
                runs.add(id)
            yield Verified(kind, id, wrong, _has_sums(found.folder))
    for folder in _entries(store / SEALED):
        id = folder.name.removeprefix("run_id=")
        # Of a run that is damaged or gone only the bytes of its seal can be verified.
        opened = told(open_seal, store, id) if id in runs else ()
        yield Verified(SEALED, id, file_faults(folder) or opened, _has_sums(folder))
    for folder in _entries(store / ROBOTS):
        wrong = file_faults(folder) or told(check_robot, folder, load_robot)
        yield Verified(ROBOTS, folder.name, wrong, _has_sums(folder))
    for path in _entries(store / MADE_WITH):
        yield Verified(MADE_WITH, path.name, told(_check_kept, path))
    for path in _entries(store / QUARANTINE):
        yield Verified(QUARANTINE, path.name, told(_check_tombstone, path))


def open_to_others(store: Path) -> bool:
    """Return whether other users of this machine may look into a store."""
    return bool(store.stat().st_mode & _OPEN_TO_OTHERS)


def _has_sums(folder: Path) -> bool:
    return (folder / SUMS).is_file()


def _entries(folder: Path) -> list[Path]:
    return sorted(folder.iterdir()) if folder.is_dir() else []


def _check_kept(path: Path) -> None:
    check_kept(path.name, path.read_bytes())


def _check_tombstone(path: Path) -> None:
    check_tombstone(path.name, path.read_bytes())
