"""A whole inbox: what rests in it is taken, what follows is told, then it is moved."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

from flows.inbox.take import (
    REFUSED,
    WAITING,
    Job,
    State,
    Taken,
    alone,
    archive,
    at_rest,
    look,
    take,
)
from flows.project.read import InboxTable, Project
from flows.requests import Import
from flows.settings import cores
from flows.workers.pool import Done, Here, Pool
from residual.errors import InputError, plain
from warehouse.commit import commit_record

_CHUNK = 32  # logs between two moves: so many are read again after a kill
_FEW = 4  # as many are read sooner than processes are started

# Told the runs of a few logs once they are in the store, before their files are moved.
Told = Callable[[Sequence[str]], None]


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
        known = {tag.partition("=")[0]: tag for tag in (*robot.tags, *self.table.tags)}
        return Import(
            logs=(str(path),),
            robot=self.project.word(robot),
            columns=str(self.project.path(self.table.map)) if self.table.map else None,
            trajectory=self.table.trajectory or None,
            kind=self.table.kind,
            store=self.project.store,
            serial=robot.serial or None,
            tags=tuple(known.values()),
        )

    def remember(self, taken: Taken) -> str:
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
        told = taken.path.stat()
        record = {
            "robot": name,
            "serial": table.serial or None,
            "kind": REFUSED,
            "log": taken.name,
            "inbox": self.table.folder,
            "state": [told.st_size, told.st_mtime_ns],
            "verdict": why,
        }
        return commit_record(self.project.store, "validations", record)


def inboxes(project: Project) -> tuple[Inbox, ...]:
    """Return the inboxes of a project."""
    return tuple(Inbox(project, table) for table in project.table.inbox)


def look_twice(of: Sequence[Inbox]) -> dict[int, Mapping[str, State]]:
    """Return what rests in inboxes, by their place: two looks, the longest quiet apart.

    Where nothing lies nobody waits.
    """
    before = [look(inbox.folder) for inbox in of]
    waits = [i.table.quiet for i, found in zip(of, before, strict=True) if found]
    if not waits:
        return {}
    time.sleep(max(waits))
    return {
        place: at_rest(before[place], look(inbox.folder))
        for place, inbox in enumerate(of)
    }


def take_all(inbox: Inbox, resting: Mapping[str, State], told: Told) -> Iterator[Taken]:
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
    with alone(folder) as ours:
        if not ours:
            why = "another modelgap takes from this inbox"
            yield from (Taken(job.path, WAITING, why=why) for job in jobs)
            return
        for chunk in _taken(jobs):
            runs = [taken.run for taken in chunk if taken.run]
            if runs:
                told(runs)
            for taken in chunk:
                yield _archived(inbox, taken)


def _taken(jobs: Sequence[Job]) -> Iterator[list[Taken]]:
    """Take logs in other processes: one that takes its process down is refused."""
    if len(jobs) <= _FEW:
        yield [_outcome(jobs, done) for done in Here().run(take, jobs)]
        return
    with Pool(min(cores(), len(jobs))) as pool:
        done = pool.run(take, jobs)
        while few := [_outcome(jobs, each) for each in islice(done, _CHUNK)]:
            yield few


def _archived(inbox: Inbox, taken: Taken) -> Taken:
    """Move a log out of the way; one that cannot be moved waits, and stops no other."""
    try:
        if taken.what == REFUSED:
            inbox.remember(taken)
        archive(taken)
    except (OSError, InputError) as error:
        said = getattr(error, "strerror", None) or error
        why = f"{taken.why or taken.what}; it cannot be moved: {said}"
        return replace(taken, what=WAITING, why=why)
    return taken


def _outcome(jobs: Sequence[Job], done: Done) -> Taken:
    if done.error is None:
        return done.value
    return Taken(jobs[done.index].path, REFUSED, why=plain(str(done.error)))
