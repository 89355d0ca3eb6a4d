"""Tasks of a project's flows: plain steps with a name, a time limit and what is told.

To be imported after `flows.settings.prepare_prefect`.
"""

from collections import Counter
from pathlib import Path

from prefect import get_run_logger

from flows.inbox.new import Diagnosed, new_runs
from flows.inbox.new import diagnose_new as diagnose_runs
from flows.inbox.run import inboxes, look_twice, take_all
from flows.inbox.take import KNOWN, REFUSED, STORED, WAITING
from flows.project import notify
from flows.project.notify import Notice
from flows.project.read import Project, read_project
from flows.report.words.verdict import headline
from flows.scheduled import artifacts, events, names, tasks
from flows.scheduled.surroundings import surroundings
from flows.scheduled.tasks import task
from flows.storage.diagnosis import read_verdict
from residual.errors import InputError
from warehouse.layout import find

_KINDS = (STORED, KNOWN, REFUSED, WAITING)


@task(name="inbox", task_run_name="inbox", tags=["logs"])
def take(folder: str) -> dict:
    """Take what rests in the inboxes of a project; tell what follows from it."""
    project, log = read_project(folder), get_run_logger()
    of, sums, rows, fed = inboxes(project), Counter(), [], set()
    for place, resting in look_twice(of).items():
        robot = of[place].table.robot
        for taken in take_all(of[place], resting, events.runs_committed):
            sums[taken.what] += 1
            told = taken.run or taken.why
            log.info(f"{taken.path.name}: {taken.what}: {told}")
            rows.append({"log": taken.path.name, "what": taken.what, "run": told})
            if taken.run:
                fed.add(robot)
            if taken.what == REFUSED:
                title = f"{robot}: {taken.path.name} was refused"
                _tell(project, Notice("refused", robot, title, taken.why))
    for robot in fed:
        events.logs_stored(robot)
    words = ", ".join(f"{sums[kind]} {kind}" for kind in _KINDS if sums[kind])
    if rows:
        artifacts.record("inbox", (), f"Logs of the inboxes: {words}.", rows)
    names.rename(f"inbox: {words or 'empty'}")
    return {kind: sums[kind] for kind in _KINDS}


@task(name="diagnose", task_run_name="diagnose", tags=["analysis"])
def diagnose(folder: str, robot: str) -> list[str]:
    """Watch and diagnose what is new of a robot; returns the ids, none for nothing."""
    project = read_project(folder)
    try:
        found = _diagnosed(project, robot)
    except InputError as error:
        names.rename(f"{robot}: not diagnosed")
        _tell(project, Notice("failed", robot, f"{robot}: not diagnosed", str(error)))
        raise
    if found is None:
        names.rename(f"{robot}: no new runs")
        get_run_logger().info("nothing has come in since the last time")
        return []
    many, against = len(found.batch.runs), found.batch.against
    get_run_logger().info(f"{many} new runs against {against}")
    return list(found.ids)


def _diagnosed(project: Project, robot: str) -> Diagnosed | None:
    table = project.robot(robot)
    batch = new_runs(project.store, project.arm(table), table)
    # Those of which the event was lost: the server may have been killed.
    if batch and batch.unwatched:
        tasks.watch(list(batch.unwatched), None, [], str(project.store))
        names.rename(f"{robot}: {len(batch.runs)} new runs")
    return diagnose_runs(project, robot, surroundings().progress)


def tell_of(folder: str, robot: str, diagnosis: str, page: str) -> None:
    """Tell people what a diagnosis found, if it found something."""
    project = read_project(folder)
    verdict = read_verdict(project.store, diagnosis)
    if verdict.effects:
        title = f"{robot}: {headline(verdict)}"
        _tell(project, Notice("finding", robot, title, "", (diagnosis,), page))


def tell(folder: str, kind: str, ids: list[str]) -> None:
    """Tell people of what an event says: runs with an alarm, or a diagnosis."""
    project = read_project(folder)
    if kind == "alarm":
        robot = _robot_of(project.store, ids[0])
        title = f"{robot}: {len(ids)} runs with an alarm"
    else:
        verdict = read_verdict(project.store, ids[0])
        robot, title = verdict.robot, f"{verdict.robot}: {headline(verdict)}"
    _tell(project, Notice(kind, robot, title, ids=tuple(ids)))


def _robot_of(store: Path, run: str) -> str:
    return find(store, run).folder.parent.name.removeprefix("robot=")


def _tell(project: Project, notice: Notice) -> None:
    for why in notify.tell(project, notice):
        get_run_logger().warning(f"not told: {why}")
