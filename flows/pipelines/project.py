"""The flows inbox and diagnose-new of a project.

To be imported under `flows.settings.build_prefect_environment`;
`flows.project.deployments` has their schedules.
"""

from collections import Counter

from prefect import flow, get_run_logger

from flows.inbox.batches import diagnose_new_runs as diagnose_runs
from flows.inbox.batches import find_new_runs, find_project_robot
from flows.inbox.import_logs import (
    KNOWN,
    REFUSED,
    STORED,
    WAITING,
    import_inbox_logs,
    list_inboxes,
    wait_for_unchanged_logs,
)
from flows.pipelines import adoption_flow, tasks
from flows.pipelines.tasks import task
from flows.project.deployments import STORED as ARRIVED
from flows.project.deployments import build_robot_resource
from flows.project.read import read_project
from flows.report.document import build_text_table
from flows.settings import HEALTHY, resolve_store_folder
from flows.steps.monitor import find_diagnosis, find_healthy_runs
from residual.errors import InputError

_LIMIT = 12 * tasks.HOUR


_KINDS = (STORED, KNOWN, REFUSED, WAITING)


@task(name="inbox", task_run_name="inbox", tags=["logs"])
def take(folder: str) -> dict:
    """Import the logs in the inboxes of a project, and send the events."""
    project, log = read_project(folder), get_run_logger()
    of, sums, rows, fed = list_inboxes(project), Counter(), [], set()
    for place, resting in wait_for_unchanged_logs(of).items():
        robot = of[place].table.robot
        for taken in import_inbox_logs(of[place], resting, tasks.send_runs_committed):
            sums[taken.status] += 1
            outcome = taken.run or taken.why
            log.info(f"{taken.name}: {taken.status}: {outcome}")
            rows.append((taken.name, taken.status, outcome))
            if taken.run:
                fed.add(robot)
            if taken.status == REFUSED:
                title = f"{robot}: {taken.name} was refused"
                tasks.send_notice("refused", robot, title, taken.why)
    for robot in fed:
        tasks.send_event(ARRIVED, {"robot": robot}, build_robot_resource(robot))
    words = ", ".join(f"{sums[kind]} {kind}" for kind in _KINDS if sums[kind])
    if rows:
        table = build_text_table(("log", "outcome", "run or reason"), rows)
        tasks.publish_text("inbox", (), [f"Logs of the inboxes: {words}.", table])
    tasks.rename_flow_run(f"inbox: {words or 'empty'}")
    return {kind: sums[kind] for kind in _KINDS}


@task(name="diagnose", task_run_name="diagnose", tags=["analysis"])
def diagnose(folder: str, robot: str) -> list[str]:
    """Monitor and diagnose the new runs of a robot; return the ids of the records."""
    project = read_project(folder)
    table = project.robot(robot)
    try:
        batch = find_new_runs(project.store, project.arm(table), table)
        # The server may have been killed before their event started the monitoring.
        if batch and batch.unwatched:
            runs, store = list(batch.unwatched), str(project.store)
            tasks.watch(runs, None, [], store, table.healthy)
            tasks.rename_flow_run(f"{robot}: {len(batch.runs)} new runs")
        outcome = diagnose_runs(project, robot)
    except InputError as error:
        tasks.rename_flow_run(f"{robot}: not diagnosed")
        tasks.send_notice("failed", robot, f"{robot}: not diagnosed", str(error))
        raise
    if outcome is None:
        tasks.rename_flow_run(f"{robot}: no new runs")
        get_run_logger().info("no new runs")
        return []
    count, against = len(outcome.batch.runs), outcome.batch.against
    get_run_logger().info(f"{count} new runs against {against}")
    return list(outcome.ids)


def find_healthy_tag(folder: str, runs: list[str]) -> str:
    """Return the tag of healthy runs, of the robot of some runs."""
    table = find_project_robot(read_project(folder), runs)
    return table.healthy if table else HEALTHY


@flow(name="inbox", flow_run_name="inbox", timeout_seconds=_LIMIT)
def inbox(project: str) -> dict:
    """Check and import the logs in the inboxes of a project; return their counts.

    Events start the flows `monitor` and, if the project sets `batch`, `diagnose-new`.
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
    """Diagnose the new runs of a real robot, or runs with an alarm; return the report.

    Runs with an alarm are diagnosed with all new runs of their robot in the project;
    without a project once, against the healthy runs.

    Args:
        project: Folder of the project.
        robot: Name of the robot in it.
        runs: Ids of runs with an alarm, instead of a robot.
        good: Ids of healthy runs of the arm.
    """
    if project and runs and (table := find_project_robot(read_project(project), runs)):
        robot = table.name
    if project and robot:
        tasks.rename_flow_run(robot)
        ids, read = diagnose(project, robot), read_project(project)
        if not ids:
            return None
        page = tasks.report(ids, str(read.store))
        adoption_flow.adopt_or_propose(ids[0], str(read.store), read.robot(robot).auto)
        return page
    if not runs:
        raise InputError("diagnose-new needs a project with its robot, or runs.")
    place = resolve_store_folder(store)
    if known := find_diagnosis(runs, place):
        name = tasks.format_run_name(known, place)
        tasks.rename_flow_run(f"explained already: {name}")
        get_run_logger().info(f"diagnosis {known} has these runs")
        return None
    healthy = find_healthy_runs(runs, place)
    healthy = healthy or [run for run in good or [] if run not in runs]
    roles = {"fit": runs, "held_out": [], "baseline": list(healthy)}
    return tasks.report(tasks.diagnose(roles, str(place)), str(place))
