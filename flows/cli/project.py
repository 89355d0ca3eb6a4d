"""modelgap init and inbox."""

import time
from collections import Counter
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from flows.outputs import show_progress_bar
from flows.requests import Flag, RobotName
from flows.settings import PROJECT
from residual.errors import InputError, strip_control_characters

if TYPE_CHECKING:
    from flows.inbox.import_logs import Inbox
    from flows.project.read import Project

_PAUSE = 5.0  # s between two looks


def init(folder: str = ".", /, *, robot: RobotName = None, simulated: Flag = False) -> None:
    """Create a project: modelgap.toml with robots, inboxes, schedules and store.

    ```
    modelgap init --robot arm.urdf
    modelgap init cell4 --robot ur10_folder
    modelgap init trial --robot irb140 --simulated
    ```

    The file explains every option and shows its default. Then put logs into inbox/ and
    start the service: modelgap up. An existing file is not overwritten.

    Args:
        folder: Folder of the project; created if it does not exist.
        robot: Robot file, folder or built-in name. Default: the simulated IRB140.
        simulated: Run a nightly campaign on a simulated arm of this robot.
    """
    from flows.project.read import create_project

    project = create_project(folder, robot, simulated)
    print(f"wrote {project.folder / PROJECT}")
    for inbox in project.table.inbox:
        print(f"logs of {inbox.robot} go into {project.path(inbox.folder)}")
    there = "" if project.folder == Path.cwd() else f" in {project.folder}"
    print(f"edit it if you like, then{there}: modelgap up")


def inbox(folder: str = ".", /, *, once: Flag = False, import_only: Flag = False) -> None:
    """Import, monitor and diagnose the logs in the inboxes of a project.

    ```
    modelgap inbox
    modelgap inbox --once
    modelgap inbox --once --import-only
    ```

    Does without a server what modelgap up does on a schedule. A log that has not
    changed for some seconds is checked and imported; its file moves to done/, or to
    rejected/ with a text file that gives the reason. Then each robot is diagnosed once
    for all new logs. It can be stopped at any time: nothing is lost or stored twice.

    Args:
        folder: Folder of the project (modelgap.toml).
        once: Return after the logs that are there now; default: run until Ctrl-C.
        import_only: Do not monitor or diagnose.
    """
    from flows.inbox.import_logs import KNOWN, REFUSED, STORED, WAITING, list_inboxes, list_logs
    from flows.project.read import read_project

    project = read_project(folder)
    of = list_inboxes(project)
    if not of:
        raise InputError(
            "modelgap.toml has no [[inbox]]. Add one with robot and folder, then again."
        )
    while True:
        counts = _import_round(project, of, import_only)
        if once:
            # Files that still change, and empty ones, wait too.
            counts[WAITING] = sum(len(list_logs(inbox.folder)) for inbox in of)
            kinds = (STORED, KNOWN, REFUSED, WAITING)
            print(", ".join(f"{counts[kind]} {kind}" for kind in kinds))
            return
        if not counts:
            time.sleep(_PAUSE)


def _import_round(project: "Project", of: Sequence["Inbox"], import_only: bool) -> Counter:
    from flows.inbox.batches import diagnose_new_runs
    from flows.inbox.import_logs import import_inbox_logs, wait_for_unchanged_logs
    from flows.report.sentences import format_headline
    from flows.steps.monitor import monitor_new_runs

    counts: Counter = Counter()

    def monitor(robot: str, runs: Sequence[str]) -> None:
        try:
            outcome = monitor_new_runs(runs, project.store, tag=project.robot(robot).healthy)
        except InputError as error:
            _say(f"{robot}: not monitored: {error}")
            return
        if outcome.alarmed:
            _say(f"{robot}: alarms in {len(outcome.alarmed)} of {len(runs)} new runs")

    for index, logs in wait_for_unchanged_logs(of).items():
        report = partial(monitor, of[index].table.robot)
        report = (lambda _: None) if import_only else report
        for number, log in enumerate(import_inbox_logs(of[index], logs, report), 1):
            counts[log.status] += 1
            text = f"run {log.run}" if log.run else log.why
            _say(f"{number}/{len(logs)} {log.name}: {log.status}: {text}")
    for table in project.table.robot if counts and not import_only else ():
        if table.simulated:
            continue
        try:
            with show_progress_bar() as progress:
                done = diagnose_new_runs(project, table.name, progress)
        except InputError as error:
            _say(f"{table.name}: not diagnosed: {error}")
            continue
        if done is not None:
            against = f"{len(done.batch.runs)} new runs against {done.batch.against}"
            _say(f"{table.name}: {format_headline(done.verdict)} ({against})")
            _say(f"stored as a diagnosis: modelgap show {done.ids[0]}")
    return counts


def _say(text: str) -> None:
    print(strip_control_characters(text), flush=True)
