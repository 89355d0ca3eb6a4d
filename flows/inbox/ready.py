"""Which files of an inbox are whole: those that rest, and that nobody is writing."""

import fcntl
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

DONE, REJECTED = "done", "rejected"
_LOCK = ".modelgap.lock"
# Names that programs give to what they have not yet written to its end.
_UNFINISHED = (".part", ".partial", ".tmp", ".temp", ".crdownload", ".filepart", "~")
_BAG = "metadata.yaml"  # what a ROS 2 bag, a folder, has in it

# Size, time of the last change [ns] and number of a file; of a folder, all of those.
State = tuple[tuple[int, int, int], ...]


def look(folder: Path) -> dict[str, State]:
    """Return what lies in an inbox, by name: files, and folders that are ROS 2 bags.

    Hidden files and names of what is not finished (.part, .tmp and the like) are left
    alone until their writer renames them.
    """
    found = {}
    with os.scandir(folder) as entries:
        for entry in entries:
            name = entry.name
            if name.startswith(".") or name.lower().endswith(_UNFINISHED):
                continue
            if name in (DONE, REJECTED) or entry.is_symlink():
                continue
            state = state_of(Path(entry.path))
            if state:
                found[name] = state
    return dict(sorted(found.items()))


def state_of(path: Path) -> State:
    """Return what changes when a log does; () for what is none, or has gone."""
    try:
        if path.is_file():
            return (_one(path),)
        if (path / _BAG).is_file():
            return tuple(_one(p) for p in sorted(path.rglob("*")) if p.is_file())
    except OSError:
        pass  # renamed or removed meanwhile
    return ()


def _one(path: Path) -> tuple[int, int, int]:
    told = path.stat()
    return told.st_size, told.st_mtime_ns, told.st_ino


def at_rest(before: Mapping[str, State], now: Mapping[str, State]) -> dict[str, State]:
    """Return what has not changed between two looks, and holds something.

    Clocks are not asked: that of a file server may be another.
    """
    return {
        name: state
        for name, state in now.items()
        if before.get(name) == state and sum(size for size, _, _ in state)
    }


def being_written(path: Path) -> bool:
    """Whether a program of this machine has a file open for writing, where that shows.

    Linux grants a read lease only where nobody has (fcntl(2), F_SETLEASE).
    """
    if not path.is_file():
        return False
    try:
        file = os.open(path, os.O_RDONLY)
    except OSError:
        return False
    try:
        fcntl.fcntl(file, fcntl.F_SETLEASE, fcntl.F_RDLCK)
        fcntl.fcntl(file, fcntl.F_SETLEASE, fcntl.F_UNLCK)
    except BlockingIOError:
        return True
    except OSError:
        return False  # a file system without leases, or a file of somebody else
    finally:
        os.close(file)
    return False


@contextmanager
def alone(folder: Path) -> Iterator[bool]:
    """Hold an inbox, so that no two take from it; whoever dies holds nothing."""
    with (folder / _LOCK).open("a") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            yield False
            return
        yield True
