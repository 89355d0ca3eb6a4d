"""Inboxes: import the logs in a folder, and diagnose the new runs of a robot.

A kill is harmless: a run is committed, then reported, then its file is moved; a file
that was not moved is imported again, to the same run id. A record of kind "batch" has
the runs of a diagnosis as parents: after a kill before that record, the same runs are
diagnosed again, with the same id.
"""

import filecmp
import os
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np

from flows.outputs import write_files
from flows.project import InboxTable, Project, RobotTable
from flows.requests import Diagnose, Import
from flows.settings import count_cores, prefect_home
from flows.steps import imports
from flows.steps.diagnose import build_diagnose_request, diagnose_stored_runs
from flows.steps.model_choice import resolve_adopted_model
from flows.storage import read_verdict
from flows.workers import InlineExecutor, JobResult, ProcessExecutor, lock_file, run_jobs
from residual.errors import InputError, shorten_value, strip_control_characters
from residual.robot.robot import Robot
from residual.verdict.result import Verdict
from warehouse.queries import query_store_rows
from warehouse.record_commit import commit_record

STORED, KNOWN, REFUSED, WAITING = "stored", "known", "refused", "waiting"
DONE, REJECTED = "done", "rejected"
LOCK = ".modelgap.lock"
# Endings of files that are not complete.
_UNFINISHED = (".part", ".partial", ".tmp", ".temp", ".crdownload", ".filepart", "~")
_BAG = "metadata.yaml"  # file in the folder of a ROS 2 bag

# Size, time of change [ns] and inode of a file, or of all files in a folder.
FileState = tuple[tuple[int, int, int], ...]


def list_logs(folder: Path) -> dict[str, FileState]:
    """Return the logs of an inbox by name: files, and folders that are ROS 2 bags.

    Skips hidden files and files that are not complete (.part, .tmp and others).
    """
    states = {}
    with os.scandir(folder) as entries:
        for entry in entries:
            name = entry.name
            if name.startswith(".") or name.lower().endswith(_UNFINISHED):
                continue
            if entry.is_symlink() or (name in (DONE, REJECTED) and entry.is_dir()):
                continue
            state = read_log_state(Path(entry.path))
            if state:
                states[name] = state
    return dict(sorted(states.items()))


def read_log_state(path: Path) -> FileState:
    """Return the state of a log; () if it is none, or was removed."""
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


def select_unchanged(
    before: Mapping[str, FileState], now: Mapping[str, FileState]
) -> dict[str, FileState]:
    """Return the logs with the same state in both listings, without empty files.

    Compares no clocks: a file server has its own.
    """
    return {
        name: state
        for name, state in now.items()
        if before.get(name) == state and sum(size for size, _, _ in state)
    }


@dataclass(frozen=True, slots=True)
class LogImport:
    """A log to import."""

    path: Path
    state: FileState
    request: Import


@dataclass(frozen=True, slots=True)
class ImportOutcome:
    """The result for one log."""

    path: Path  # the file, or the folder of a bag
    # "stored", "known" (these samples were in the store), "refused" or "waiting".
    status: str
    run: str | None = None  # id of its run
    why: str = ""  # reason for "refused" and "waiting"

    @property
    def name(self) -> str:
        """Name of the file, safe to print."""
        return shorten_value(strip_control_characters(self.path.name))


def import_log(job: LogImport) -> ImportOutcome:
    """Check and store a log; the file is not moved.

    A full disk and a file that changes are temporary: the log waits.
    """
    try:
        robot, read = imports.read_logs(job.request)
        (log,), _ = imports.check_logs(job.request, robot, read)
        if read_log_state(job.path) != job.state:
            return ImportOutcome(job.path, WAITING, why="it changed while it was read")
        run = imports.store_log(log, job.request, robot)
    except InputError as error:
        if read_log_state(job.path) != job.state:
            return ImportOutcome(job.path, WAITING, why="it changed while it was read")
        final = job.path.parent / REJECTED / job.path.name
        why = str(error).replace(str(job.path), str(final))
        return ImportOutcome(job.path, REFUSED, why=strip_option_hints(why))
    except (OSError, MemoryError) as error:
        why = strip_control_characters(" ".join(str(error).split()))
        return ImportOutcome(job.path, WAITING, why=why)
    except Exception as error:  # of a parser, for a damaged file
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        why = strip_control_characters(f"unexpected failure: {reason}")
        return ImportOutcome(job.path, REFUSED, why=why)
    return ImportOutcome(job.path, KNOWN if log.stored else STORED, run)


def strip_option_hints(reason: str) -> str:
    """Return a reason without options of the command line."""
    reason = strip_control_characters(
        reason.replace(" To continue anyway: --trust-log (trust_log=True).", "")
    )
    if "--map" not in reason:
        return reason
    reason = re.sub(r"(with )?--map( COLUMNS\.toml)?", r"\1COLUMNS.toml", reason)
    return (
        f"{reason}\nAn inbox reads that file if modelgap.toml names it under "
        '[[inbox]]: map = "COLUMNS.toml". Then put the log into the inbox again.'
    )


def move_imported_log(outcome: ImportOutcome) -> Path | None:
    """Move a log to done/, or to rejected/ with the reason in a text file; one that waits stays."""
    if outcome.status == WAITING:
        return None
    folder = outcome.path.parent / (REJECTED if outcome.status == REFUSED else DONE)
    folder.mkdir(exist_ok=True)
    target, number = folder / outcome.path.name, 1
    while target.exists():  # another log of that name; the same bytes replace it
        files = outcome.path.is_file() and target.is_file()
        if files and filecmp.cmp(outcome.path, target, shallow=False):
            break
        number += 1
        target = folder / f"{outcome.path.stem}-{number}{outcome.path.suffix}"
    if outcome.status == REFUSED:
        # The reason first: after a kill, every refused file has one.
        write_files({target.with_name(f"{target.name}.txt"): f"{outcome.why}\n"})
    os.replace(outcome.path, target)
    return target


_CHUNK = 32  # logs between two moves; as many are read again after a kill
_FEW = 4  # for up to this number, starting processes takes longer

# Called with the ids of runs after they are stored, before their files are moved.
Report = Callable[[Sequence[str]], None]


@dataclass(frozen=True, slots=True)
class Inbox:
    """An inbox of a project."""

    project: Project
    table: InboxTable

    @property
    def folder(self) -> Path:
        """The folder, created if it does not exist."""
        place = self.project.path(self.table.folder)
        place.mkdir(parents=True, exist_ok=True)
        return place

    def request(self, path: Path) -> Import:
        """Return the import request for a log."""
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

    def save_outcome(self, outcome: ImportOutcome) -> str:
        """Store that a log was refused, and why; one file has one record."""
        table = self.project.robot(self.table.robot)
        try:
            name = self.project.arm(table).name
        except InputError:  # then all logs of the robot are refused
            name = table.name
        why = outcome.why
        why = why if why.startswith(outcome.name) else f"{outcome.name}: {why}"
        stat = outcome.path.stat()
        record = {
            "robot": name,
            "serial": table.serial or None,
            "kind": REFUSED,
            "log": outcome.name,
            "inbox": self.table.folder,
            "state": [stat.st_size, stat.st_mtime_ns],
            "verdict": why,
        }
        return commit_record(self.project.store, "validations", record)


def list_inboxes(project: Project) -> tuple[Inbox, ...]:
    """Return the inboxes of a project."""
    return tuple(Inbox(project, table) for table in project.table.inbox)


def wait_for_unchanged_logs(inboxes: Sequence[Inbox]) -> dict[int, Mapping[str, FileState]]:
    """Return the logs that do not change for `quiet` seconds, by index of the inbox.

    Returns at once if there are none.
    """
    before = [list_logs(inbox.folder) for inbox in inboxes]
    waits = [i.table.quiet for i, logs in zip(inboxes, before, strict=True) if logs]
    if not waits:
        return {}
    time.sleep(max(waits))
    return {
        place: select_unchanged(before[place], list_logs(inbox.folder))
        for place, inbox in enumerate(inboxes)
    }


def import_inbox_logs(
    inbox: Inbox, unchanged: Mapping[str, FileState], report: Report
) -> Iterator[ImportOutcome]:
    """Import logs of an inbox and move their files; yields the result for each."""
    folder = inbox.folder
    jobs = [
        LogImport(folder / name, state, inbox.request(folder / name))
        for name, state in unchanged.items()
    ]
    if not jobs:
        return
    with lock_file(folder / LOCK) as ours:
        if not ours:
            why = "another modelgap uses this inbox"
            yield from (ImportOutcome(job.path, WAITING, why=why) for job in jobs)
            return
        for chunk in _import_chunks(jobs):
            runs = [taken.run for taken in chunk if taken.run]
            if runs:
                report(runs)
            for taken in chunk:
                yield _archive_or_wait(inbox, taken)


def _import_chunks(jobs: Sequence[LogImport]) -> Iterator[list[ImportOutcome]]:
    """Import logs in processes; a log whose process dies is refused."""
    if len(jobs) <= _FEW:
        yield [_outcome_of(jobs, done) for done in run_jobs(InlineExecutor(), import_log, jobs)]
        return
    with ProcessExecutor(min(count_cores(), len(jobs))) as processes:
        done = run_jobs(processes, import_log, jobs)
        while few := [_outcome_of(jobs, each) for each in islice(done, _CHUNK)]:
            yield few


def _archive_or_wait(inbox: Inbox, taken: ImportOutcome) -> ImportOutcome:
    try:
        if taken.status == REFUSED:
            inbox.save_outcome(taken)
        move_imported_log(taken)
    except (OSError, InputError) as error:
        reason = getattr(error, "strerror", None) or error
        why = f"{taken.why or taken.status}; it cannot be moved: {reason}"
        return replace(taken, status=WAITING, why=why)
    return taken


def _outcome_of(jobs: Sequence[LogImport], done: JobResult) -> ImportOutcome:
    if done.error is None:
        return done.value
    return ImportOutcome(
        jobs[done.index].path, REFUSED, why=strip_control_characters(str(done.error))
    )


KIND = ROLE = "batch"
_PROOF = 3  # from this number of logs on, one is held out
_QUERY = """
    SELECT run_id, list_contains(coalesce(tags, []), $healthy) AS healthy,
           run_id IN (SELECT parent FROM lineage WHERE role = $role) AS taken,
           run_id IN (SELECT parent FROM lineage WHERE role = 'watched') AS watched
    FROM runs
    WHERE robot = $robot AND serial IS NOT DISTINCT FROM $serial
          AND source = 'imported' AND NOT quarantined
    ORDER BY coalesce(recorded_at, created), run_id
"""

_WHOSE = """
    SELECT DISTINCT robot, serial, source FROM runs WHERE list_contains($runs, run_id)
"""


@dataclass(frozen=True, slots=True)
class Batch:
    """Runs that are diagnosed together."""

    runs: tuple[str, ...]  # all new runs, in the order of their time
    # On all of them, or on a limited number spread over them; compared with the adopted
    # model, else with the healthy runs.
    request: Diagnose
    unwatched: tuple[str, ...] = ()  # new runs without monitoring

    @property
    def against(self) -> str:
        """Text: the model or the runs that they are compared with."""
        if self.request.model:
            return f"the adopted model, of diagnosis {self.request.model[:8]}"
        if self.request.baseline:
            return f"{len(self.request.baseline)} healthy runs"
        return "the model as described"


@dataclass(frozen=True, slots=True)
class BatchDiagnosis:
    """The diagnosis of a batch."""

    batch: Batch
    ids: tuple[str, str]
    verdict: Verdict


def find_new_runs(store: Path, robot: Robot, table: RobotTable) -> Batch | None:
    """Return the new runs of a robot, None if there are none."""
    if not store.is_dir():
        return None
    about = {"robot": robot.name, "serial": robot.serial, "healthy": table.healthy}
    rows = query_store_rows(store, _QUERY, **about, role=ROLE)
    healthy = [row["run_id"] for row in rows if row["healthy"]]
    new = [row for row in rows if not row["taken"] and not row["healthy"]]
    runs = [row["run_id"] for row in new]
    if not runs:
        return None
    # Evenly spread, with the first and the last.
    places = np.linspace(0, len(runs) - 1, min(len(runs), table.most)).round().astype(int)
    chosen = [runs[place] for place in places]
    proof = chosen[-1:] if len(chosen) >= _PROOF else []
    model = resolve_adopted_model(chosen, store).diagnosis
    roles = {
        "fit": [run for run in chosen if run not in proof],
        "held_out": proof,
        "baseline": () if model else healthy[-table.most :],
    }
    unwatched = tuple(row["run_id"] for row in new if not row["watched"])
    return Batch(tuple(runs), build_diagnose_request(roles, store, model), unwatched)


def diagnose_new_runs(
    project: Project, name: str, progress: Callable[[str, float], None] | None = None
) -> BatchDiagnosis | None:
    """Diagnose the new runs of a robot; None if there are none."""
    table, store = project.robot(name), project.store
    arm = project.arm(table)
    # Schedule, import and alarm may start one at the same time: the first takes all new
    # runs, the others find none.
    with lock_file(prefect_home(store) / f"diagnose-{name}.lock", wait=True):
        batch = find_new_runs(store, arm, table)
        if batch is None:
            return None
        ids = diagnose_stored_runs(batch.request, progress)
        record = {"robot": arm.name, "serial": arm.serial, "kind": KIND}
        parents = {"diagnosis": [ids[0]], ROLE: list(batch.runs)}
        commit_record(store, "validations", record | {"project": name}, parents=parents)
    return BatchDiagnosis(batch, ids, read_verdict(store, ids[0]))


def find_project_robot(project: Project, runs: Sequence[str]) -> RobotTable | None:
    """Return the real robot that measured runs are of; None where they are of none."""
    rows = query_store_rows(project.store, _WHOSE, runs=list(runs))
    for table in project.table.robot:
        if table.simulated or len(rows) != 1:
            continue
        arm = project.arm(table)
        if rows == [{"robot": arm.name, "serial": arm.serial, "source": "imported"}]:
            return table
    return None
