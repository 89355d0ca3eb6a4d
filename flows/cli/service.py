"""modelgap up, status and down."""

import os
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from shlex import quote

from rich.console import Console

from flows.outputs import json_text, print_plain
from flows.requests import Flag, Seconds, Store
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
    build_prefect_environment,
    prefect_home,
    resolve_store_folder,
)
from residual.errors import InputError, RunError

_DEFAULT, NOTHING = ServiceRequest(), "nothing runs"


def up(*, request: ServiceRequest = _DEFAULT, foreground: Flag = False) -> None:
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
    from flows.inbox.import_logs import list_inboxes
    from flows.project.deployments import build_deployments
    from flows.project.read import read_current_project
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
        _say("warning: not encrypted; who listens in the network may run programs.")
    word = "already runs" if was_up else "is up"
    key = place / PREFECT / KEY
    print(f"{format_store_name(place)} {word}: {running.ui}")
    print(f"it asks for the key: cat {quote(str(key))}")
    for folder in folders:
        print(f"logs go into {folder}")
    named = [each["name"] for each in build_deployments(project)["deployments"]]
    print(f"deployed: {', '.join(named)}; {running.workers} at once")
    print("for the command prefect:")
    print(f"  export {API}={running.url}")
    print(f'  export {CLIENT}="$(cat {quote(str(key))})"')
    if foreground:
        wait_for_stop_signal(place, _say)
    else:
        print(f"all reports: {running.pages}/index.html (user modelgap; the")
        print("password is the key behind the colon)")
        print("modelgap status shows what is due; modelgap down stops it")


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
    from flows.service.api import read_status

    found = read_status(home)
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
    from flows.pipelines.proposals import cancel_settled_proposals
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
    from flows.report.document import (
        ReportTable,
        build_text_table,
        print_parts,
        widen_piped_console,
    )
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
        rows = [_run(run) for run in status["runs"]]
        heads = ("flow run", "state", "begun (UTC)", "time [s]")
        print_parts(console, ReportTable(heads, rows, text_columns=range(3)))


def _due(deployment: Mapping) -> str:
    if deployment["paused"]:
        return "paused"
    if deployment["due"]:
        return _second(deployment["due"])
    return "soon" if deployment["schedules"] else "on an event, or by hand"


def _second(time: str | None) -> str:
    return (time or "–")[:19].replace("T", " ")


def _run(run: Mapping) -> tuple[str, str, str, str]:
    begun = _second(run["start_time"])
    return run["name"], run["state"], begun, f"{run['total_run_time']:.1f}"
