"""modelgap init, inbox, up, status and down: a project and its service."""

import os
import sys
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from shlex import quote
from threading import Timer
from typing import TYPE_CHECKING

from rich.console import Console

from flows.outputs import json_text, print_plain, show_progress_bar
from flows.requests import Flag, RobotName, Seconds, Store
from flows.service.state import (
    CLIENT,
    DATABASE,
    KEY,
    ServiceRequest,
    check_request,
    is_process_running,
    read_access_key,
    read_running,
)
from flows.settings import (
    API,
    PREFECT,
    PROJECT,
    build_prefect_environment,
    prefect_home,
    resolve_store_folder,
)
from residual.errors import InputError, RunError, strip_control_characters

if TYPE_CHECKING:
    from flows.project import Project
    from flows.steps.inbox import Inbox

_PAUSE = 5.0  # s between two looks, or until a line says what is waited for


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
    from flows.project import create_project

    project = create_project(folder, robot, simulated)
    print(f"wrote {project.folder / PROJECT}")
    for inbox in project.table.inbox:
        print(f"logs of {inbox.robot} go into {project.path(inbox.folder)}")
    there = "" if project.folder == Path.cwd() else f" in {project.folder}"
    print(f"edit it if needed, then run{there}: modelgap up")


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
    from flows.project import read_project
    from flows.steps.inbox import KNOWN, REFUSED, STORED, WAITING, list_inboxes, list_logs

    project = read_project(folder)
    of = list_inboxes(project)
    if not of:
        raise InputError("modelgap.toml has no [[inbox]]. Add one with robot and folder.")
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
    from flows.report.sentences import format_headline
    from flows.steps.inbox import diagnose_new_runs, import_inbox_logs, wait_for_unchanged_logs
    from flows.steps.monitor import monitor_new_runs

    counts: Counter = Counter()

    def monitor(robot: str, runs: Sequence[str]) -> None:
        try:
            outcome = monitor_new_runs(runs, project.store, tag=project.robot(robot).healthy)
        except InputError as error:
            _print_line(f"{robot}: not monitored: {error}")
            return
        if outcome.alarmed:
            _print_line(f"{robot}: alarms in {len(outcome.alarmed)} of {len(runs)} new runs")

    for index, logs in wait_for_unchanged_logs(of).items():
        report = partial(monitor, of[index].table.robot)
        report = (lambda _: None) if import_only else report
        for number, log in enumerate(import_inbox_logs(of[index], logs, report), 1):
            counts[log.status] += 1
            text = f"run {log.run}" if log.run else log.why
            _print_line(f"{number}/{len(logs)} {log.name}: {log.status}: {text}")
    for table in project.table.robot if counts and not import_only else ():
        if table.simulated:
            continue
        try:
            with show_progress_bar() as progress:
                done = diagnose_new_runs(project, table.name, progress)
        except InputError as error:
            _print_line(f"{table.name}: not diagnosed: {error}")
            continue
        if done is not None:
            against = f"{len(done.batch.runs)} new runs against {done.batch.against}"
            _print_line(f"{table.name}: {format_headline(done.verdict)} ({against})")
            _print_line(f"stored as a diagnosis: modelgap show {done.ids[0]}")
    return counts


def _print_line(text: str) -> None:
    print(strip_control_characters(text), flush=True)


NOTHING = "nothing is running"


def up(*, request: ServiceRequest = ServiceRequest(), foreground: Flag = False) -> None:
    """Start server, worker and schedules of a store.

    ```
    modelgap up
    modelgap up --every 60 --port 4300
    modelgap status
    modelgap down
    ```

    In a folder with a modelgap.toml (modelgap init) it serves that project; run it
    again after a change of the file. It keeps what runs and restarts what was killed.
    The server listens on this machine only and sends nothing elsewhere. Its page asks
    for the key of the store, which is in the file that the command prints.

    Args:
        foreground: Run until Ctrl-C, then stop everything; for service managers.
    """
    from flows.project import build_deployments, read_current_project
    from flows.steps.inbox import list_inboxes
    from warehouse.remote_store import format_store_name

    place = resolve_store_folder(request.store)
    project = read_current_project(place)
    database = os.environ.get(DATABASE) or None
    request = replace(request, store=place, database=database, project=project)
    if project:
        port, workers = project.table.port, project.table.workers
        request = replace(request, port=request.port or port, workers=request.workers or workers)
    check_request(request)
    _prepare(prefect_home(place))
    from flows.service.up import start_service as bring_up
    from flows.service.up import wait_for_stop_signal

    folders = [inbox.folder for inbox in list_inboxes(project)] if project else []
    running, was_up = bring_up(request, _say)
    if request.trust_network:
        _say("warning: not encrypted; an eavesdropper on the network can run programs.")
    word = "is already running" if was_up else "is up"
    key = place / PREFECT / KEY
    print(f"{format_store_name(place)} {word}: {running.ui}")
    print(f"the page asks for the key: cat {quote(str(key))}")
    for folder in folders:
        print(f"logs go into {folder}")
    named = [each["name"] for each in build_deployments(project)["deployments"]]
    print(f"deployed: {', '.join(named)}; {running.workers} flow(s) at once")
    print("for Prefect's command line:")
    print(f"  export {API}={running.url}")
    print(f'  export {CLIENT}="$(cat {quote(str(key))})"')
    if foreground:
        wait_for_stop_signal(place, _say)
    else:
        print(f"all reports: {running.pages}/index.html (user modelgap; the")
        print("password is the key behind the colon)")
        print("modelgap status shows the schedule; modelgap down stops everything")


def status(*, json: Flag = False, store: Store = None) -> None:
    """Show server, worker, schedules and the last flow runs.

    ```
    modelgap status
    modelgap status --json
    ```

    Exit code 0 if the next scheduled run will start, else 1.

    Args:
        json: Print JSON.
    """
    from warehouse.remote_store import format_store_name

    place = resolve_store_folder(store)
    home = place / PREFECT
    if not home.is_dir():
        print('{"schema": 1, "healthy": false, "stopped": true}' if json else NOTHING)
        raise RunError(f"{format_store_name(place)} is stopped. Start it: modelgap up")
    _prepare(home)
    waits = Timer(_PAUSE, _say, ("waiting for the answer of the server",))
    waits.daemon = True
    waits.start()
    try:
        from flows.service.api import read_status

        found = read_status(home)
    finally:
        waits.cancel()
    if json:
        print(json_text(found), end="")
    else:
        _print_status(found, place)
    if found["stopped"]:
        raise RunError(f"{format_store_name(place)} is stopped. Start it: modelgap up")
    if found["wrong"]:
        raise RunError(f"{format_store_name(place)}: {'; '.join(found['wrong'])}.")


def down(*, wait: Seconds = 60.0, store: Store = None) -> None:
    """Stop server and worker of a store.

    ```
    modelgap down
    modelgap down --wait 0
    ```

    Starts no new flow runs, waits for those that run, and cancels them after --wait.
    Schedules, history and stored runs are kept.

    Args:
        wait: Longest time for flow runs to finish, in seconds.
    """
    from warehouse.remote_store import format_store_name

    if not 0 <= wait < 1e6:
        raise InputError(f"--wait {wait:g}: expected 0 or more seconds.")
    place = resolve_store_folder(store)
    home, stopped = place / PREFECT, None
    if home.is_dir():
        _prepare(home)
        from flows.service.up import stop_service as stop

        stopped = stop(home, wait, _say)
    print(f"{format_store_name(place)}: {'stopped' if stopped else NOTHING}")


def settle_proposals(store: Path) -> None:
    """Cancel in Prefect, if its server runs, the proposals that an adoption settled."""
    home = store / PREFECT
    running = read_running(home)
    if running is None or not is_process_running(home, "server"):
        return
    _prepare(home)
    from flows.pipelines import cancel_settled_proposals
    from flows.service.api import Api

    try:
        with Api(running.url, read_access_key(home)).client() as client:
            cancel_settled_proposals(client, store)
    except RunError as error:
        _say(f"{error} The next modelgap up cancels settled proposals.")


def _prepare(home: Path) -> None:
    os.environ.update(build_prefect_environment(home))


def _say(text: str) -> None:
    print(f"modelgap: {text}", file=sys.stderr, flush=True)


def _print_status(status: Mapping, store: Path) -> None:
    from flows.report import ReportTable, build_text_table, print_parts, widen_piped_console
    from warehouse.remote_store import format_store_name

    console = widen_piped_console(Console())
    if status["stopped"]:
        print_plain(console, f"{format_store_name(store)}: {NOTHING}")
        return
    word = "answers" if status["server"] else "does not answer"
    lines = [f"server   {word}: {status['ui']} (history: {status['database']})"]
    lines += [f"worker   {status['worker']}, {status['workers']} flow(s) at once"]
    lines += [f"{name:8} {address}" for name, address in status["pages"].items()]
    lines += [f"refused  {row['robot']}: {row['why']}" for row in status["refused"]]
    print_plain(console, *lines)
    if status["deployments"]:
        rows = [(d["name"], _due(d)) for d in status["deployments"]]
        print_parts(console, build_text_table(("deployment", "due next (UTC)"), rows))
    if status["runs"]:
        rows = [
            (r["name"], r["state"], _second(r["start_time"]), f"{r['total_run_time']:.1f}")
            for r in status["runs"]
        ]
        heads = ("flow run", "state", "started (UTC)", "time [s]")
        print_parts(console, ReportTable(heads, rows, text_columns=range(3)))


def _due(deployment: Mapping) -> str:
    if deployment["paused"]:
        return "paused"
    if deployment["due"]:
        return _second(deployment["due"])
    return "soon" if deployment["schedules"] else "on an event, or by hand"


def _second(time: str | None) -> str:
    return (time or "–")[:19].replace("T", " ")
