"""Flows of a project: its inboxes, the nights of its real robots, who is told.

To be imported after `flows.settings.prepare_prefect`; `flows.project.deployments` says
when each is started.
"""

from prefect import flow

from flows.project.read import read_project
from flows.scheduled import loop_tasks, project_tasks, tasks

_LIMIT = 12 * tasks.HOUR


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
    return project_tasks.take(project)


@flow(name="diagnose-new", flow_run_name="{robot}", timeout_seconds=_LIMIT)
def diagnose_new(project: str, robot: str) -> str | None:
    """Diagnose what has come in of a real robot since the last time, and report.

    Args:
        project: Folder of the project.
        robot: Name of the robot.

    Returns:
        The page, None where nothing has come in.
    """
    ids = project_tasks.diagnose(project, robot)
    if not ids:
        return None
    read = read_project(project)
    store, auto = str(read.store), read.robot(robot).auto
    page = tasks.report(ids, store)
    project_tasks.tell_of(project, robot, ids[0], page)
    loop_tasks.adopt_or_propose(ids[0], store, auto)
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
    project_tasks.tell(project, kind, listed)
