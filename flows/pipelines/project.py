"""Flows of a project: its inboxes and the nights of its real robots.

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
from flows.pipelines import artifacts, loop, tasks
from flows.pipelines.tasks import task
from flows.project.deployments import STORED as ARRIVED
from flows.project.deployments import resource
from flows.project.read import Project, read_project
from flows.report.document import words_table
from flows.report.words.verdict import headline
from flows.settings import HEALTHY, store_folder
from flows.storage.diagnosis import read_verdict
from residual.errors import InputError

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
            rows.append((taken.name, taken.what, outcome))
            if taken.run:
                fed.add(robot)
            if taken.what == REFUSED:
                title = f"{robot}: {taken.name} was refused"
                artifacts.notice("refused", robot, title, taken.why)
    for robot in fed:
        artifacts.tell(ARRIVED, {"robot": robot}, resource(robot))
    words = ", ".join(f"{sums[kind]} {kind}" for kind in _KINDS if sums[kind])
    if rows:
        table = words_table(("log", "outcome", "run or reason"), rows)
        artifacts.record("inbox", (), [f"Logs of the inboxes: {words}.", table])
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
        artifacts.notice("failed", robot, f"{robot}: not diagnosed", str(error))
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


def tag_of(folder: str, runs: list[str]) -> str:
    """Return the tag of the healthy runs of the robot that runs are of."""
    table = robot_of_runs(read_project(folder), runs)
    return table.healthy if table else HEALTHY


def found(diagnosis: str, store: str, page: str) -> None:
    """Tell, once, what a diagnosis found, if it found something."""
    verdict = read_verdict(Path(store), diagnosis)
    if verdict.effects:
        title = f"{verdict.robot}: {headline(verdict)}"
        link = artifacts.link_of(Path(page))
        artifacts.notice("finding", verdict.robot, title, ids=[diagnosis], page=link)


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


@flow(name="diagnose-new", timeout_seconds=_LIMIT)
def diagnose_new(
    project: str | None = None,
    robot: str | None = None,
    runs: list[str] | None = None,
    good: list[str] | None = None,
    store: str | None = None,
) -> str | None:
    """Diagnose what has come in of a real robot, or runs with an alarm, and report.

    Runs with an alarm of a robot of a project are diagnosed with all that is new of
    it; others once, and against the healthy runs of the arm, where there are such.

    Args:
        project: Folder of the project, None for none.
        robot: Name of the robot in it.
        runs: Ids of runs with an alarm, instead of a robot.
        good: Ids of healthy runs of the arm.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.

    Returns:
        The page; None where nothing is new.
    """
    if project and runs and (table := robot_of_runs(read_project(project), runs)):
        robot = table.name
    if project and robot:
        artifacts.rename(robot)
        return _diagnosed_new(project, robot)
    if not runs:
        raise InputError("diagnose-new needs a project with its robot, or runs.")
    place = str(store_folder(store))
    if tasks.diagnosed_already(runs, place):
        return None
    roles = {"fit": runs, "held_out": []}
    roles["baseline"] = tasks.healthy(runs, good or [], place)
    ids = tasks.diagnose(roles, place)
    page = tasks.report(ids, place)
    found(ids[0], place, page)
    return page


def _diagnosed_new(project: str, robot: str) -> str | None:
    """Diagnose what is new of a robot, tell people, propose; returns the page."""
    ids = diagnose(project, robot)
    if not ids:
        return None
    read = read_project(project)
    store, auto = str(read.store), read.robot(robot).auto
    page = tasks.report(ids, store)
    found(ids[0], store, page)
    loop.adopt_or_propose(ids[0], store, auto)
    return page
