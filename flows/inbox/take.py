"""Logs out of an inbox: into the store, or refused; then out of the way.

The order makes a kill harmless: the run is committed, then what follows is told, then
the file is moved. Until it is moved it is taken again, and then found in the store: its
id is that of its samples and its robot.
"""

import fcntl
import filecmp
import os
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

from flows.outputs import write_all
from flows.project.read import InboxTable, Project
from flows.requests import Import
from flows.settings import cores
from flows.steps import imports
from flows.workers.processes import InlineExecutor, JobResult, Processes, spread
from residual.errors import InputError, plain, shortened
from warehouse.commit import commit_record

STORED, KNOWN, REFUSED, WAITING = "stored", "known", "refused", "waiting"
DONE, REJECTED = "done", "rejected"
_LOCK = ".modelgap.lock"
# Names that programs give to what they have not yet written to its end.
_UNFINISHED = (".part", ".partial", ".tmp", ".temp", ".crdownload", ".filepart", "~")
_BAG = "metadata.yaml"  # what a ROS 2 bag, a folder, has in it

# Size, time of the last change [ns] and number of a file; of a folder, all of those.
State = tuple[tuple[int, int, int], ...]


def list_logs(folder: Path) -> dict[str, State]:
    """Return what lies in an inbox, by name: files, and folders that are ROS 2 bags.

    Hidden files and names of what is not finished (.part, .tmp and the like) are left
    alone until their writer renames them.
    """
    states = {}
    with os.scandir(folder) as entries:
        for entry in entries:
            name = entry.name
            if name.startswith(".") or name.lower().endswith(_UNFINISHED):
                continue
            if entry.is_symlink() or (name in (DONE, REJECTED) and entry.is_dir()):
                continue
            state = state_of(Path(entry.path))
            if state:
                states[name] = state
    return dict(sorted(states.items()))


def state_of(path: Path) -> State:
    """Return what changes when a log does; () for what is none, or has gone."""
    try:
        if path.is_file():
            return (_file_state(path),)
        if (path / _BAG).is_file():
            return tuple(_file_state(p) for p in sorted(path.rglob("*")) if p.is_file())
    except OSError:
        pass  # renamed or removed meanwhile
    return ()


def _file_state(path: Path) -> tuple[int, int, int]:
    stat = path.stat()
    return stat.st_size, stat.st_mtime_ns, stat.st_ino


def unchanged(
    before: Mapping[str, State], now: Mapping[str, State]
) -> dict[str, State]:
    """Return what has not changed between two looks, and holds something.

    Clocks are not asked: that of a file server may be another.
    """
    return {
        name: state
        for name, state in now.items()
        if before.get(name) == state and sum(size for size, _, _ in state)
    }


@contextmanager
def locked(folder: Path) -> Iterator[bool]:
    """Hold an inbox, so that no two take from it; whoever dies holds nothing."""
    with (folder / _LOCK).open("a") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            yield False
            return
        yield True


@dataclass(frozen=True, slots=True)
class Job:
    """A log that rests in an inbox."""

    path: Path
    state: State
    request: Import


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of a log."""

    path: Path  # the file, or the folder of a bag
    # "stored", "known" (the same samples of the same robot were in the store),
    # "refused" or "waiting".
    status: str
    run: str | None = None  # id of its run, None where it has none
    why: str = ""  # why it was refused or has to wait

    @property
    def name(self) -> str:
        """What its file is called, as it is printed and kept."""
        return shortened(plain(self.path.name))


def take(job: Job) -> Outcome:
    """Check a log and put it into the store; the file stays where it is.

    Returns:
        What became of it. What may be well in a minute, such as a full disk or a file
        that somebody writes to again, has to wait and is lost by nobody.
    """
    try:
        robot, read = imports.read_logs(job.request)
        (log,), _ = imports.check_logs(job.request, robot, read)
        if state_of(job.path) != job.state:
            return Outcome(job.path, WAITING, why="it changed while it was read")
        run = imports.store_log(log, job.request, robot)
    except InputError as error:
        if state_of(job.path) != job.state:
            return Outcome(job.path, WAITING, why="it changed while it was read")
        return Outcome(
            job.path, REFUSED, why=inbox_reason(_final_paths(str(error), job))
        )
    except (OSError, MemoryError) as error:
        return Outcome(job.path, WAITING, why=plain(" ".join(str(error).split())))
    except Exception as error:  # what a damaged file makes a parser raise
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        return Outcome(job.path, REFUSED, why=plain(f"unexpected failure: {reason}"))
    return Outcome(job.path, KNOWN if log.stored else STORED, run)


def _final_paths(why: str, job: Job) -> str:
    """Return a reason with the place at which the log then is."""
    then = job.path.parent / REJECTED / job.path.name
    return why.replace(str(job.path), str(then))


def inbox_reason(why: str) -> str:
    """Return why a log was refused, with what mends it where there are no options."""
    why = plain(why.replace(" Or go on with --trust-log (trust_log=True).", ""))
    if "--map" not in why:
        return why
    why = re.sub(r"(with )?--map( COLUMNS\.toml)?", r"\1COLUMNS.toml", why)
    return (
        f"{why}\nThe inbox reads that file where modelgap.toml says so under "
        '[[inbox]]: map = "COLUMNS.toml". Then put the log into the inbox again.'
    )


def archive(taken: Outcome) -> Path | None:
    """Move a log out of the way: into done/, or into rejected/ with the reason beside.

    Returns:
        Where it is now; None where it waits.

    Raises:
        OSError: If it cannot be moved.
    """
    if taken.status == WAITING:
        return None
    folder = taken.path.parent / (REJECTED if taken.status == REFUSED else DONE)
    folder.mkdir(exist_ok=True)
    target, number = folder / taken.path.name, 1
    while target.exists():  # another log of that name; the same bytes replace it
        files = taken.path.is_file() and target.is_file()
        if files and filecmp.cmp(taken.path, target, shallow=False):
            break
        number += 1
        target = folder / f"{taken.path.stem}-{number}{taken.path.suffix}"
    if taken.status == REFUSED:
        # The reason first: a file that was refused has one, at any kill.
        write_all({target.with_name(f"{target.name}.txt"): f"{taken.why}\n"})
    os.replace(taken.path, target)
    return target


# A whole inbox: what rests in it is taken, a few logs at a time.

_CHUNK = 32  # logs between two moves: so many are read again after a kill
_FEW = 4  # as many are read sooner than processes are started

# Called with the ids of runs after they are stored, before their files are moved.
Report = Callable[[Sequence[str]], None]


@dataclass(frozen=True, slots=True)
class Inbox:
    """An inbox of a project."""

    project: Project
    table: InboxTable

    @property
    def folder(self) -> Path:
        """The folder, made if it is not there."""
        place = self.project.path(self.table.folder)
        place.mkdir(parents=True, exist_ok=True)
        return place

    def request(self, path: Path) -> Import:
        """Return how a log of it is imported."""
        robot = self.project.robot(self.table.robot)
        tags = {tag.partition("=")[0]: tag for tag in (*robot.tags, *self.table.tags)}
        return Import(
            logs=(str(path),),
            robot=self.project.word(robot),
            columns=str(self.project.path(self.table.map)) if self.table.map else None,
            trajectory=self.table.trajectory or None,
            kind=self.table.kind,
            store=self.project.store,
            serial=robot.serial or None,
            tags=tuple(tags.values()),
        )

    def remember(self, taken: Outcome) -> str:
        """Keep in the store that a log was refused, and why; returns the record's id.

        The same file, taken again after a kill, leaves one record.
        """
        table = self.project.robot(self.table.robot)
        try:
            name = self.project.arm(table).name
        except InputError:  # of which all logs are refused
            name = table.name
        why = taken.why
        why = why if why.startswith(taken.name) else f"{taken.name}: {why}"
        stat = taken.path.stat()
        record = {
            "robot": name,
            "serial": table.serial or None,
            "kind": REFUSED,
            "log": taken.name,
            "inbox": self.table.folder,
            "state": [stat.st_size, stat.st_mtime_ns],
            "verdict": why,
        }
        return commit_record(self.project.store, "validations", record)


def inboxes(project: Project) -> tuple[Inbox, ...]:
    """Return the inboxes of a project."""
    return tuple(Inbox(project, table) for table in project.table.inbox)


def unchanged_logs(of: Sequence[Inbox]) -> dict[int, Mapping[str, State]]:
    """Return what rests in inboxes, by their place: two looks, the longest quiet apart.

    Where nothing lies nobody waits.
    """
    before = [list_logs(inbox.folder) for inbox in of]
    waits = [i.table.quiet for i, logs in zip(of, before, strict=True) if logs]
    if not waits:
        return {}
    time.sleep(max(waits))
    return {
        place: unchanged(before[place], list_logs(inbox.folder))
        for place, inbox in enumerate(of)
    }


def import_all(
    inbox: Inbox, resting: Mapping[str, State], report: Report
) -> Iterator[Outcome]:
    """Take what rests in an inbox, a few logs at a time.

    Yields:
        What became of each log, once its file is where it belongs.
    """
    folder = inbox.folder
    jobs = [
        Job(folder / name, state, inbox.request(folder / name))
        for name, state in resting.items()
    ]
    if not jobs:
        return
    with locked(folder) as ours:
        if not ours:
            why = "another modelgap takes from this inbox"
            yield from (Outcome(job.path, WAITING, why=why) for job in jobs)
            return
        for chunk in _import_chunks(jobs):
            runs = [taken.run for taken in chunk if taken.run]
            if runs:
                report(runs)
            for taken in chunk:
                yield _archive_or_wait(inbox, taken)


def _import_chunks(jobs: Sequence[Job]) -> Iterator[list[Outcome]]:
    """Take logs in other processes: one that takes its process down is refused."""
    if len(jobs) <= _FEW:
        yield [_outcome_of(jobs, done) for done in spread(InlineExecutor(), take, jobs)]
        return
    with Processes(min(cores(), len(jobs))) as processes:
        done = spread(processes, take, jobs)
        while few := [_outcome_of(jobs, each) for each in islice(done, _CHUNK)]:
            yield few


def _archive_or_wait(inbox: Inbox, taken: Outcome) -> Outcome:
    """Move a log out of the way; one that cannot be moved waits, and stops no other."""
    try:
        if taken.status == REFUSED:
            inbox.remember(taken)
        archive(taken)
    except (OSError, InputError) as error:
        reason = getattr(error, "strerror", None) or error
        why = f"{taken.why or taken.status}; it cannot be moved: {reason}"
        return replace(taken, status=WAITING, why=why)
    return taken


def _outcome_of(jobs: Sequence[Job], done: JobResult) -> Outcome:
    if done.error is None:
        return done.value
    return Outcome(jobs[done.index].path, REFUSED, why=plain(str(done.error)))
