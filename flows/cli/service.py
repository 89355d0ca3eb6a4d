"""modelgap up, status and down: the server of a store, and what it serves."""

import os
import sys
from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING

from rich.console import Console

from flows.inbox.take import inboxes
from flows.outputs import json_text, say
from flows.project.deployments import deployments
from flows.project.read import project_here
from flows.report.console import show, wide
from flows.report.document import Table, words_table
from flows.requests import Flag, Seconds, Store
from flows.service.request import DATABASE, ServiceRequest, checked
from flows.service.state import CLIENT, KEY
from flows.settings import API, PREFECT, prefect_home, quiet_prefect, store_folder
from residual.errors import InputError, RunError
from warehouse.remote import store_name

if TYPE_CHECKING:
    from flows.service.api import Status

_USUAL, NOTHING = ServiceRequest(), "nothing runs"


def up(*, request: ServiceRequest = _USUAL, foreground: Flag = False) -> None:
    """Start server, worker and schedules of a store, and return when they answer.

    ```
    modelgap up
    modelgap up --every 60 --port 4300
    modelgap status
    modelgap down
    ```

    In a folder with a modelgap.toml (modelgap init) it serves that project, and again
    after a change of it. Doing it again is no error: what runs is left alone and its
    address is printed, what was killed is started again. Nothing is sent anywhere; the
    server listens on this machine only, and takes orders from its own page and programs
    of the store. The page asks for the key of the store once, in a file of which the
    command prints the name.

    Args:
        foreground: Stay until Ctrl-C, then stop everything; for service managers.
    """
    place = store_folder(request.store)
    project = project_here(place)
    database = os.environ.get(DATABASE) or None
    request = replace(request, store=place, database=database, project=project)
    if project:
        port, workers = project.table.port, project.table.workers
        request = replace(
            request, port=request.port or port, workers=request.workers or workers
        )
    checked(request)
    _prepare(prefect_home(place))
    from flows.service.up import stay
    from flows.service.up import up as bring_up

    folders = [inbox.folder for inbox in inboxes(project)] if project else []
    running, was_up = bring_up(request, _say)
    if request.trust_network:
        _say("warning: not encrypted; who listens in the network may run programs.")
    word = "already runs" if was_up else "is up"
    key = place / PREFECT / KEY
    print(f"{store_name(place)} {word}: {running.ui}")
    print(f"it asks for the key: cat {quote(str(key))}")
    for folder in folders:
        print(f"logs go into {folder}")
    named = [each["name"] for each in deployments(project)["deployments"]]
    print(f"deployed: {', '.join(named)}; {running.workers} at once")
    print("for the command prefect:")
    print(f"  export {API}={running.url}")
    print(f'  export {CLIENT}="$(cat {quote(str(key))})"')
    if foreground:
        stay(place, _say)
    else:
        print(f"all reports: {running.pages}/index.html (user modelgap; the")
        print("password is the key behind the colon)")
        print("modelgap status shows what is due; modelgap down stops it")


def status(*, json: Flag = False, store: Store = None) -> None:
    """Show server, workers, pages, what is due next, and the last flow runs.

    ```
    modelgap status
    modelgap status --json
    ```

    The exit code is 0 if the next schedule will fire and be run, else 1.

    Args:
        json: Print it as JSON.
    """
    place = store_folder(store)
    home = place / PREFECT
    if not home.is_dir():
        print('{"schema": 1, "healthy": false, "stopped": true}' if json else NOTHING)
        raise RunError(f"{store_name(place)} is stopped. Start it: modelgap up")
    _prepare(home)
    from flows.service.api import status as state_of

    found = state_of(home)
    if json:
        print(json_text(found.document()), end="")
    else:
        _print_status(found, place)
    if found.running is None or found.running.stopped:
        raise RunError(f"{store_name(place)} is stopped. Start it: modelgap up")
    if found.wrong:
        raise RunError(f"{store_name(place)}: {'; '.join(found.wrong)}.")


def down(*, wait: Seconds = 60.0, store: Store = None) -> None:
    """Stop worker and server of a store; schedules and history stay.

    ```
    modelgap down
    modelgap down --wait 0
    ```

    Nothing new is begun, and flow runs that are under way may end. What takes longer
    than --wait is ended and marked as such; runs that it has stored are kept.

    Args:
        wait: How long flow runs may go on, in seconds.
    """
    if not 0 <= wait < 1e6:
        raise InputError(f"--wait {wait:g}: expected 0 or more seconds.")
    place = store_folder(store)
    home, stopped = place / PREFECT, None
    if home.is_dir():
        _prepare(home)
        from flows.service.up import down as stop

        stopped = stop(home, wait, _say)
    print(f"{store_name(place)}: {'stopped' if stopped else NOTHING}")


def _prepare(home: Path) -> None:
    """Set what Prefect takes when it is imported."""
    os.environ.update(quiet_prefect(home))


def _say(text: str) -> None:
    print(f"modelgap: {text}", file=sys.stderr, flush=True)


def _print_status(found: "Status", store: Path) -> None:
    console = wide(Console())
    running = found.running
    if running is None or running.stopped:
        say(console, f"{store_name(store)}: {NOTHING}")
        return
    word = "answers" if found.server else "does not answer"
    lines = [f"server   {word}: {running.ui} (history: {running.database})"]
    lines += [f"worker   {found.worker}, {running.workers} flow(s) at once"]
    lines += [f"{name:8} {address}" for name, address in found.pages.items()]
    lines += [f"refused  {row['robot']}: {row['why']}" for row in found.refused]
    say(console, *lines)
    if found.deployments:
        rows = [(d["name"], _due(d)) for d in found.deployments]
        show(console, words_table(("deployment", "due next (UTC)"), rows))
    if found.runs:
        rows = [_run(run) for run in found.runs]
        heads = ("flow run", "state", "begun (UTC)", "time [s]")
        show(console, Table(heads, rows, left=range(3)))


def _due(deployment: Mapping) -> str:
    if deployment["paused"]:
        return "paused"
    if deployment["due"]:
        left = (deployment["due"] - datetime.now(UTC)).total_seconds()
        when = deployment["due"].astimezone(UTC).isoformat(" ", "seconds")[:19]
        return f"{when}, in {_span(left)}"
    if deployment["schedules"]:
        return "soon known"
    return "on an event, or by hand"


def _span(seconds: float) -> str:
    if seconds < 0:
        return "no time: late"
    for unit, length in (("d", 86400), ("h", 3600), ("min", 60)):
        if seconds >= 2 * length:
            return f"{seconds / length:.0f} {unit}"
    return f"{seconds:.0f} s"


def _run(run: Mapping) -> tuple[str, str, str, str]:
    begun = (run["start_time"] or "–")[:19].replace("T", " ")
    return run["name"], run["state"], begun, f"{run['total_run_time']:.1f}"
