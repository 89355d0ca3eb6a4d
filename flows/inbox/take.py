"""One log out of an inbox: into the store, or refused; then out of the way.

The order makes a kill harmless: the run is committed, then what follows is told, then
the file is moved. Until it is moved it is taken again, and then found in the store: its
id is that of its samples and its robot.
"""

import filecmp
import os
from dataclasses import dataclass
from pathlib import Path

from flows.inbox.ready import DONE, REJECTED, State, being_written, state_of
from flows.requests import Import
from flows.steps import imports
from residual.errors import InputError

STORED, KNOWN, REFUSED, WAITING = "stored", "known", "refused", "waiting"


@dataclass(frozen=True, slots=True)
class Job:
    """A log that rests in an inbox.

    Attributes:
        path: The file, or the folder of a bag.
        state: What it was when it was found at rest.
        request: How it is imported; its one log is the path.
    """

    path: Path
    state: State
    request: Import


@dataclass(frozen=True, slots=True)
class Taken:
    """What became of a log.

    Attributes:
        path: The file, or the folder of a bag.
        what: "stored", "known" (the same samples of the same robot were in the store),
            "refused" or "waiting".
        run: Id of its run, None where it has none.
        why: Why it was refused or has to wait.
    """

    path: Path
    what: str
    run: str | None = None
    why: str = ""


def take(job: Job) -> Taken:
    """Check a log and put it into the store; the file stays where it is.

    Returns:
        What became of it. What may be well in a minute, such as a full disk or a file
        that somebody writes to again, has to wait and is lost by nobody.
    """
    if being_written(job.path):
        return Taken(job.path, WAITING, why="somebody is writing it")
    try:
        robot, read = imports.read_logs(job.request)
        (log,), _ = imports.check_logs(job.request, robot, read)
        if state_of(job.path) != job.state:
            return Taken(job.path, WAITING, why="it changed while it was read")
        run = imports.store_log(log, job.request, robot)
    except InputError as error:
        if state_of(job.path) != job.state:
            return Taken(job.path, WAITING, why="it changed while it was read")
        return Taken(job.path, REFUSED, why=str(error))
    except (OSError, MemoryError) as error:
        return Taken(job.path, WAITING, why=" ".join(str(error).split()))
    except Exception as error:  # what a damaged file makes a parser raise
        what = " ".join(f"{type(error).__name__}: {error}".split())
        return Taken(job.path, REFUSED, why=f"unexpected failure: {what}")
    return Taken(job.path, KNOWN if log.stored else STORED, run)


def put_away(taken: Taken) -> Path | None:
    """Move a log out of the way: into done/, or into rejected/ with the reason beside.

    Returns:
        Where it is now; None where it waits.
    """
    if taken.what == WAITING:
        return None
    folder = taken.path.parent / (REJECTED if taken.what == REFUSED else DONE)
    folder.mkdir(exist_ok=True)
    target = _free(folder, taken.path)
    if taken.what == REFUSED:
        # The reason first: a file that was refused has one, at any kill.
        note = target.with_name(f"{target.name}.txt")
        draft = note.with_name(f".{note.name}.part")
        draft.write_text(f"{taken.why}\n", encoding="utf-8")
        os.replace(draft, note)
    os.replace(taken.path, target)
    return target


def _free(folder: Path, path: Path) -> Path:
    """Return a place of this name, or, where another log has it, of one beside it."""
    target, number = folder / path.name, 1
    while target.exists():
        files = path.is_file() and target.is_file()
        if files and filecmp.cmp(path, target, shallow=False):
            return target  # the same bytes: nothing is lost
        number += 1
        target = folder / f"{path.stem}-{number}{path.suffix}"
    return target
