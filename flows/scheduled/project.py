"""Flows of a project: its inboxes, the nights of its real robots, who is told.

To be imported under `flows.settings.quiet_prefect`; `flows.project.deployments` says
when each is started.
"""

from collections import Counter
from pathlib import Path

from prefect import flow, get_run_logger

from flows.inbox.new import Diagnosed, new_runs, robot_of_runs
from flows.inbox.new import diagnose_new as diagnose_runs
from flows.inbox.take import (
    KNOWN,
    REFUSED,
    STORED,
    WAITING,
    inboxes,
    look_twice,
    take_all,
)
from flows.project.deployments import STORED as ARRIVED
from flows.project.deployments import resource
from flows.project.notify import Notice
from flows.project.notify import tell as send
from flows.project.read import Project, read_project
from flows.report.words.verdict import headline
from flows.scheduled import artifacts, loop, tasks
from flows.scheduled.tasks import task
from flows.settings import HEALTHY
from flows.storage.diagnosis import read_verdict
from residual.errors import InputError
from warehouse.layout import find

_LIMIT = 12 * tasks.HOUR


_KINDS = (STORED, KNOWN, REFUSED, WAITING)


@task(name="inbox", task_run_name="inbox", tags=["logs"])
def take(folder: str) -> dict:
    """Take what rests in the inboxes of a project; tell what follows from it."""
    project, log = read_project(folder), get_run_logger()
    of, sums, rows, fed = inboxes(project), Counter(), [], set()
    for place, resting in look_twice(of).items():
        robot = of[place].table.robot
        for taken in take_all(of[place], resting, artifacts.runs_committed):
            sums[taken.what] += 1
            outcome = taken.run or taken.why
            log.info(f"{taken.name}: {taken.what}: {outcome}")
            rows.append({"log": taken.name, "what": taken.what, "run": outcome})
            if taken.run:
                fed.add(robot)
            if taken.what == REFUSED:
                title = f"{robot}: {taken.name} was refused"
                _tell(project, Notice("refused", robot, title, taken.why))
    for robot in fed:
        artifacts.tell(ARRIVED, {"robot": robot}, resource(robot))
    words = ", ".join(f"{sums[kind]} {kind}" for kind in _KINDS if sums[kind])
    if rows:
        artifacts.record("inbox", (), f"Logs of the inboxes: {words}.", rows)
    artifacts.rename(f"inbox: {words or 'empty'}")
    return {kind: sums[kind] for kind in _KINDS}


@task(name="diagnose", task_run_name="diagnose", tags=["analysis"])
def diagnose(folder: str, robot: str) -> list[str]:
    """Watch and diagnose what is new of a robot; returns the ids, none for nothing."""
    project = read_project(folder)
    try:
        found = _diagnosed(project, robot)
    except InputError as error:
        artifacts.rename(f"{robot}: not diagnosed")
        _tell(project, Notice("failed", robot, f"{robot}: not diagnosed", str(error)))
        raise
    if found is None:
        artifacts.rename(f"{robot}: no new runs")
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
        runs, store = list(batch.unwatched), str(project.store)
        tasks.watch(runs, None, [], store, table.healthy)
        artifacts.rename(f"{robot}: {len(batch.runs)} new runs")
    return diagnose_runs(project, robot)


def robot_of(folder: str, runs: list[str]) -> str | None:
    """Return the name of the real robot that runs are of, None where of none."""
    table = robot_of_runs(read_project(folder), runs)
    return table.name if table else None


def tag_of(folder: str, runs: list[str]) -> str:
    """Return the tag of the healthy runs of the robot that runs are of."""
    table = robot_of_runs(read_project(folder), runs)
    return table.healthy if table else HEALTHY


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
    for why in send(project, notice):
        get_run_logger().warning(f"not told: {why}")


@flow(name="inbox", flow_run_name="inbox", timeout_seconds=_LIMIT)
def inbox(project: str) -> dict:
    """Check and store what dropped into the inboxes of a project.

    What is stored is watched by the flow `monitor` and, where the project says so,
    diagnosed at once by `diagnose-new`: once for all of it.

    Args:
        project: Folder of the project.

    Returns:
        How many logs were stored, known, refused, or have to wait.
    """
    return take(project)


@flow(name="diagnose-new", flow_run_name="{robot}", timeout_seconds=_LIMIT)
def diagnose_new(project: str, robot: str) -> str | None:
    """Diagnose what has come in of a real robot since the last time, and report.

    Args:
        project: Folder of the project.
        robot: Name of the robot.

    Returns:
        The page, None where nothing has come in.
    """
    return diagnosed_new(project, robot)


def diagnosed_new(project: str, robot: str) -> str | None:
    """Diagnose what is new of a robot, tell people, propose; returns the page."""
    ids = diagnose(project, robot)
    if not ids:
        return None
    read = read_project(project)
    store, auto = str(read.store), read.robot(robot).auto
    page = tasks.report(ids, store)
    tell_of(project, robot, ids[0], page)
    loop.adopt_or_propose(ids[0], store, auto)
    return page


@flow(name="notify", flow_run_name="notify {kind}", timeout_seconds=tasks.HOUR)
def notify(project: str, kind: str, ids: list[str] | str) -> None:
    """Tell people of an alarm, or of a model that a simulated night proposes.

    Args:
        project: Folder of the project.
        kind: "alarm" or "finding".
        ids: Ids of the runs with an alarm, or of the diagnosis.
    """
    listed = [ids] if isinstance(ids, str) else ids
    tell(project, kind, listed)
