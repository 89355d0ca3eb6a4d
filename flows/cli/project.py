"""modelgap init and inbox."""

import time
from collections import Counter
from pathlib import Path

from flows.inbox.new import diagnose_new
from flows.inbox.take import (
    KNOWN,
    REFUSED,
    STORED,
    WAITING,
    Inbox,
    Outcome,
    import_all,
    inboxes,
    list_logs,
    unchanged_logs,
)
from flows.outputs import progress_bar
from flows.project.read import Project, read_project, start
from flows.report.words.verdict import headline
from flows.requests import Flag, RobotName
from flows.settings import PROJECT
from flows.steps.monitor import watch_new
from residual.errors import InputError, plain

_PAUSE = 5.0  # s between two looks


def init(
    folder: str = ".", /, *, robot: RobotName = None, simulated: Flag = False
) -> None:
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
    project = start(folder, robot, simulated)
    print(f"wrote {project.folder / PROJECT}")
    for inbox in project.table.inbox:
        print(f"logs of {inbox.robot} go into {project.path(inbox.folder)}")
    there = "" if project.folder == Path.cwd() else f" in {project.folder}"
    print(f"edit it if you like, then{there}: modelgap up")


def inbox(
    folder: str = ".", /, *, once: Flag = False, import_only: Flag = False
) -> None:
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
    project = read_project(folder)
    of = inboxes(project)
    if not of:
        raise InputError(
            "modelgap.toml has no [[inbox]]. Add one with robot and folder, then again."
        )
    while True:
        sums = _round(project, of, import_only)
        if once:
            # What is still written, or empty, waits too, though nobody has tried it.
            sums[WAITING] = sum(len(list_logs(inbox.folder)) for inbox in of)
            words = ", ".join(f"{sums[what]} {what}" for what in _WORDS)
            print(words)
            return
        if not sums:
            time.sleep(_PAUSE)


_WORDS = (STORED, KNOWN, REFUSED, WAITING)


def _round(project: Project, of: tuple[Inbox, ...], import_only: bool) -> Counter:
    sums: Counter = Counter()
    for place, resting in unchanged_logs(of).items():
        inbox = of[place]
        tell = (lambda _: None) if import_only else _watcher(project, inbox)
        for number, taken in enumerate(import_all(inbox, resting, tell), 1):
            sums[taken.status] += 1
            _say(f"{number}/{len(resting)} {_words(taken)}")
    if not import_only and sums:
        for robot in project.table.robot:
            if not robot.simulated:
                _diagnose(project, robot.name)
    return sums


def _words(taken: Outcome) -> str:
    name = taken.name
    if taken.status == STORED:
        return f"{name}: stored as run {taken.run}"
    if taken.status == KNOWN:
        return f"{name}: is run {taken.run} already"
    return f"{name}: {taken.status}: {taken.why}"


def _watcher(project: Project, inbox: Inbox):
    robot = inbox.table.robot

    def tell(runs: list[str]) -> None:
        try:
            outcome = watch_new(runs, project.store, tag=project.robot(robot).healthy)
        except InputError as error:
            _say(f"{robot}: not watched: {error}")
            return
        if outcome.alarmed:
            _say(f"{robot}: {len(outcome.alarmed)} of {len(runs)} new runs alarm")

    return tell


def _diagnose(project: Project, robot: str) -> None:
    try:
        with progress_bar() as progress:
            outcome = diagnose_new(project, robot, progress)
    except InputError as error:
        _say(f"{robot}: not diagnosed: {error}")
        return
    if outcome is None:
        return
    title = f"{robot}: {headline(outcome.verdict)}"
    _say(
        f"{title} ({len(outcome.batch.runs)} new runs against {outcome.batch.against})"
    )
    _say(f"stored as a diagnosis: modelgap show {outcome.ids[0]}")


def _say(text: str) -> None:
    print(plain(text), flush=True)
