"""Start, or complete, what runs for a store, and stop it: server, pool and worker.

What has stopped has lost nothing: it waits for flow runs, and marks those that it ends.
To be imported under `flows.settings.quiet_prefect`.
"""

import hashlib
import json
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from threading import Event
from time import monotonic, sleep

from prefect.client.orchestration import SyncPrefectClient
from prefect.client.schemas.actions import DeploymentScheduleCreate
from prefect.client.schemas.objects import State, StateType
from prefect.client.schemas.schedules import IntervalSchedule
from prefect.events import AutomationCore

from flows.project.deployments import deployments, every_of, inbox_of
from flows.service import api
from flows.service.api import answers, wait_until
from flows.service.request import (
    BEAT,
    DATABASE,
    PORT,
    ServiceRequest,
    check_host,
    server_environment,
    shown_database,
    worker_environment,
)
from flows.service.state import (
    PROCESSES,
    Running,
    lives,
    one_at_a_time,
    read_running,
    start,
    stop,
    store_key,
    write_running,
)
from flows.settings import PROJECT, ROOT, port_is_free, prefect_home
from residual.errors import InputError, RunError

Say = Callable[[str], None]
# Bytes of a message on a WebSocket, held before anybody has shown a key; an event of
# Prefect has 1.5 MB at most.
_MESSAGE = 4 << 20
_EVERY = "every"  # slug of the schedule of --every
_PATIENCE = 600.0  # s; the first start makes the database, on a busy machine slowly
_WATCH = "close flow runs without a sign of life"
ENDED = "Ended by modelgap down. What it had stored is kept; the next run goes on."
_WAIT = 60.0  # s that flow runs may go on after the request to stop
_CANCEL = 30.0  # s in which the worker ends those that are left


def up(request: ServiceRequest, say: Say) -> tuple[Running, bool]:
    """Bring up what does not run yet; what runs is left as it is.

    Returns:
        What runs now, and whether all of it ran before.
    """
    home = prefect_home(request.store)
    with one_at_a_time(home):
        running = _agreed(request, read_running(home), home)
        if _complete(running, request, home) and request.every is None:
            return running, True
        _with_server(running, home, request, say)
        to = api.Api(running.url, store_key(home))
        with to.client() as client:
            api.open_pool(client, running.workers)
            if not lives(home, "worker"):
                env = worker_environment(running, request.store, home)
                start(home, "worker", worker_command(), env)
            running = _deployed(running, home, request, client, say)
            if request.every is not None:
                for name in every_of(request.project):
                    start_every(client, name, request.every)
            _watch_for_stale(client)
            if inbox := inbox_of(request.project):
                api.start_flow(client, inbox)
            wait_until(
                lambda: _online(home, client),
                _PATIENCE,
                f"No worker reports; see {home}/worker.log.",
            )
        return running, False


def deployed_as(request: ServiceRequest) -> str:
    """Return what tells whether the deployments on a server are those of now."""
    content = _content(request) + str(ROOT).encode()
    return hashlib.sha256(content).hexdigest()[:20]


def _content(request: ServiceRequest) -> bytes:
    # JSON is YAML too.
    return json.dumps(deployments(request.project), indent=1).encode()


def _agreed(request: ServiceRequest, before: Running | None, home: Path) -> Running:
    """Return the state to start from; InputError where it contradicts the wish."""
    database = shown_database(request.database)
    if before is None:
        host, port = request.host or "127.0.0.1", request.port or PORT
        return Running(host, port, database, workers=request.workers or 1)
    asked = {"--host": request.host, "--port": request.port}
    has = {"--host": before.host, "--port": before.port}
    serves = lives(home, "server")
    for name, value in asked.items():
        if serves and value not in (None, has[name]):
            raise InputError(
                f"{request.store} is already served at {before.ui}, not with {name} "
                f"{value}. Stop it first: modelgap down."
            )
    if database != before.database and any(lives(home, p) for p in PROCESSES):
        raise InputError(
            f"{request.store} is already served at {before.ui} with its history in "
            f"{before.database}, not in {database}. Stop it first: modelgap down."
        )
    before = replace(before, workers=request.workers or before.workers)
    if serves:
        return before
    if database != before.database and request.database is None:
        raise InputError(
            f"The history of {request.store} is in {before.database}. Give its "
            f"address: ${DATABASE}."
        )
    host, port = request.host or before.host, request.port or before.port
    check_host(host, request.trust_network)
    # The database may be another one, or have been emptied: deployed anew.
    return Running(host, port, database, workers=before.workers)


def _complete(running: Running, request: ServiceRequest, home: Path) -> bool:
    return (
        all(lives(home, name) for name in PROCESSES)
        and running == read_running(home)
        and running.deployed == deployed_as(request)
        and answers(running.url)
    )


def _with_server(
    running: Running, home: Path, request: ServiceRequest, say: Say
) -> None:
    if not lives(home, "server"):
        # The worker of a server that was killed may have turned to another address.
        stop(home, "worker")
        _check_port(running)
        say(f"starting the server on port {running.port}")
        env = server_environment(running, home, request.database)
        start(home, "server", server_command(running), env)
        write_running(home, running)

    def ready() -> bool:
        if not lives(home, "server"):
            raise RunError(f"The server ended at once; see {home}/server.log.")
        return answers(running.url)

    why = f"The server does not answer; see {home}/server.log."
    wait_until(ready, _PATIENCE, why)


def server_command(running: Running) -> list[str]:
    """Return the command line of the server; it has no key and no password.

    It is what `prefect server start` runs, with the guard and the pages around it.
    """
    command = [sys.executable, "-P", "-m", "uvicorn", "--factory", "--log-level"]
    command += ["warning", "--no-proxy-headers", "flows.service.serve:app"]
    command += ["--ws-max-size", str(_MESSAGE)]
    return [*command, "--host", running.host, "--port", str(running.port)]


def worker_command() -> list[str]:
    """Return the command line of the worker: Prefect's own."""
    command = [sys.executable, "-m", "prefect", "worker", "start", "--type", "process"]
    return [*command, "--pool", api.POOL]


def _check_port(running: Running) -> None:
    if port_is_free(running.host, running.port):
        return
    what = "another Prefect server" if answers(running.url) else "another program"
    raise InputError(
        f"Port {running.port} of {running.host} is taken by {what}. Choose another: "
        f"modelgap up --port {running.port + 1}."
    )


def _deployed(
    running: Running,
    home: Path,
    request: ServiceRequest,
    client: SyncPrefectClient,
    say: Say,
) -> Running:
    wish = deployed_as(request)
    if running.deployed != wish:
        whose = PROJECT if request.project else "prefect.yaml"
        say(f"putting the deployments of {whose} on it")
        env = worker_environment(running, request.store, home)
        file, log = home / "deployments.yaml", home / "deploy.log"
        file.write_bytes(_content(request))
        command = [sys.executable, "-m", "prefect", "--no-prompt", "deploy", "--all"]
        command += ["--prefect-file", str(file)]
        with log.open("wb") as output:
            done = subprocess.run(
                command, cwd=ROOT, env=env, stdout=output, stderr=output, check=False
            )
        if done.returncode:
            raise RunError(f"The deployments were refused; see {log}.")
        api.keep_deployments(client, deployments(request.project)["deployments"])
        running = replace(running, deployed=wish)
    write_running(home, running)
    return running


def start_every(
    client: SyncPrefectClient,
    deployment: str,
    seconds: int,
    parameters: dict | None = None,
) -> None:
    """Give a deployment a further schedule from now on, instead of the one before.

    Args:
        seconds: Time between two starts [s]; 0 for no such schedule any more.
    """
    known = client.read_deployment_by_name(deployment)
    for old in known.schedules:
        if old.slug == _EVERY:
            client.delete_deployment_schedule(known.id, old.id)
    if seconds:
        new = DeploymentScheduleCreate(
            schedule=IntervalSchedule(interval=seconds),
            active=True,
            slug=_EVERY,
            parameters=parameters or {},
        )
        client.create_deployment_schedules(known.id, [new])


def _watch_for_stale(client: SyncPrefectClient) -> None:
    """Let the server itself close a flow run that gives no sign of life any more."""
    if not client.read_automations_by_name(_WATCH):
        client.create_automation(AutomationCore.model_validate(stale_rule()))


def stale_rule() -> dict:
    """Return when a flow run is closed: after it has begun to run, and not rested.

    One that waits for an answer is suspended, has no process, and gives no signs.
    """
    rests = ("Completed", "Failed", "Cancelled", "Crashed", "Suspended", "Paused")
    beat = "prefect.flow-run.heartbeat"
    trigger = {
        "type": "event",
        "match": {"prefect.resource.id": "prefect.flow-run.*"},
        "after": [beat],
        "expect": [beat, *(f"prefect.flow-run.{rest}" for rest in rests)],
        "for_each": ["prefect.resource.id"],
        "posture": "Proactive",
        "threshold": 1,
        # Two signs may get lost, and a busy machine is late.
        "within": 4 * BEAT,
    }
    action = {
        "type": "change-flow-run-state",
        "state": "CRASHED",
        "name": "Crashed",
        "message": f"No sign of life for {4 * BEAT} s.",
    }
    about = "A killed process cannot say that it has ended."
    rule = {"name": _WATCH, "enabled": True, "description": about}
    return rule | {"trigger": trigger, "actions": [action]}


def _online(home: Path, client: SyncPrefectClient) -> bool:
    if not lives(home, "worker"):
        raise RunError(f"The worker ended at once; see {home}/worker.log.")
    return api.worker_online(client)


# Stop what runs for a store, or stay beside it until then, and lose nothing of it.


def down(home: Path, wait: float, say: Say) -> Running | None:
    """Let flow runs end, then stop worker and server; schedules and history stay.

    Args:
        wait: How long flow runs may go on [s]; then they are ended and marked.
    """
    with one_at_a_time(home):
        running = read_running(home)
        if running is None or not any(lives(home, name) for name in PROCESSES):
            return None
        if lives(home, "server") and answers(running.url):
            with api.Api(running.url, store_key(home)).client() as client:
                api.open_pool(client, running.workers, paused=True)
                _finish_runs(client, home, wait, say)
        for name in reversed(PROCESSES):
            stop(home, name)
        # Port and database are those of the next start; not who may reach it.
        write_running(home, replace(running, host="127.0.0.1", stopped=True))
        return running


def _finish_runs(client: SyncPrefectClient, home: Path, wait: float, say: Say) -> None:
    """Wait for what runs; let the worker end what is left, and mark it."""
    if active := api.active_runs(client):
        say(f"waiting up to {wait:g} s for {len(active)} flow run(s) to end")
    until = monotonic() + wait
    while api.active_runs(client) and monotonic() < until:
        sleep(0.5)
    left = api.active_runs(client)
    for run in left:
        client.set_flow_run_state(run.id, _state(StateType.CANCELLING), force=True)
    until = monotonic() + (_CANCEL if lives(home, "worker") else 0.0)
    while api.active_runs(client) and monotonic() < until:
        sleep(0.5)
    stop(home, "worker")
    for run in left:
        client.set_flow_run_state(run.id, _state(StateType.CRASHED), force=True)
        say(f"ended: {run.name}")


def _state(type: StateType) -> State:
    return State(type=type, name=type.value.title(), message=ENDED)


def stay(store: Path, say: Say) -> None:
    """Return after Ctrl-C or SIGTERM, with everything stopped.

    Raises:
        RunError: If server or worker have ended; who manages us starts us again.
    """
    home, asked = prefect_home(store), Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: asked.set())
    while not asked.wait(1.0):
        running = read_running(home)
        if running is None or running.stopped:  # modelgap down, from elsewhere
            return
        if not all(lives(home, name) for name in PROCESSES):
            down(home, 0.0, say)
            raise RunError(f"Server or worker ended; see the logs in {home}.")
    down(home, _WAIT, say)
