"""Start and stop the server and the worker of a store.

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
from flows.service.state import (
    BEAT,
    DATABASE,
    PORT,
    PROCESSES,
    Running,
    ServiceRequest,
    check_host,
    database_label,
    lives,
    one_at_a_time,
    read_running,
    server_environment,
    start,
    stop,
    store_key,
    worker_environment,
    write_running,
)
from flows.settings import PROJECT, ROOT, port_is_free, prefect_home
from residual.errors import InputError, RunError

Say = Callable[[str], None]
# Bytes of a message on a WebSocket, also of one without the key; an event of Prefect
# has 1.5 MB at most.
_MESSAGE = 4 << 20
_EVERY = "every"  # slug of the schedule of --every
_PATIENCE = 600.0  # s; the first start creates the database
_STALE = "close flow runs without a sign of life"
ENDED = "Ended by modelgap down. What it had stored is kept; the next run goes on."
_WAIT = 60.0  # s for flow runs to finish after SIGTERM
_CANCEL = 30.0  # s for the worker to cancel the remaining ones


def up(request: ServiceRequest, say: Say) -> tuple[Running, bool]:
    """Start what does not run yet, and keep what runs.

    Returns:
        What runs now, and whether all of it ran before.
    """
    home = prefect_home(request.store)
    with one_at_a_time(home):
        running = _settled(request, read_running(home), home)
        complete = (
            all(lives(home, name) for name in PROCESSES)
            and running == read_running(home)
            and running.deployed == deployed_as(request)
            and answers(running.url)
        )
        if complete and request.every is None:
            return running, True
        _start_server(running, home, request, say)
        with api.Api(running.url, store_key(home)).client() as client:
            api.open_pool(client, running.workers)
            if not lives(home, "worker"):
                env = worker_environment(running, request.store, home)
                command = ["-m", "prefect", "worker", "start", "--type", "process"]
                command = [sys.executable, *command, "--pool", api.POOL]
                start(home, "worker", command, env)
            running = _deploy(running, home, request, client, say)
            if request.every is not None:
                for name in every_of(request.project):
                    start_every(client, name, request.every)
            if not client.read_automations_by_name(_STALE):
                client.create_automation(AutomationCore.model_validate(stale_rule()))
            if inbox := inbox_of(request.project):
                target = client.read_deployment_by_name(inbox)
                client.create_flow_run_from_deployment(target.id)

            def online() -> bool:
                if not lives(home, "worker"):
                    raise RunError(f"The worker ended at once; see {home}/worker.log.")
                return api.worker_online(client)

            why = f"The worker does not report; see {home}/worker.log."
            wait_until(online, _PATIENCE, why)
        return running, False


def deployed_as(request: ServiceRequest) -> str:
    """Return a hash of the deployments, to know whether a server has those of now."""
    content = _content(request) + str(ROOT).encode()
    return hashlib.sha256(content).hexdigest()[:20]


def _content(request: ServiceRequest) -> bytes:
    # JSON is YAML too.
    return json.dumps(deployments(request.project), indent=1).encode()


def _settled(request: ServiceRequest, before: Running | None, home: Path) -> Running:
    """Return host, port, database and workers; InputError where they contradict."""
    database = database_label(request.database)
    if before is None:
        host, port = request.host or "127.0.0.1", request.port or PORT
        return Running(host, port, database, workers=request.workers or 1)
    served = f"{request.store} is already served at {before.ui}"
    serves = lives(home, "server")
    for option, value, now in (
        ("--host", request.host, before.host),
        ("--port", request.port, before.port),
    ):
        if serves and value not in (None, now):
            raise InputError(
                f"{served}, not with {option} {value}. Stop it first: modelgap down."
            )
    if database != before.database:
        if any(lives(home, name) for name in PROCESSES):
            raise InputError(
                f"{served} with its history in {before.database}, not in {database}. "
                "Stop it first: modelgap down."
            )
        if request.database is None:
            raise InputError(
                f"The history of {request.store} is in {before.database}. Give its "
                f"address: ${DATABASE}."
            )
    before = replace(before, workers=request.workers or before.workers)
    if serves:
        return before
    host, port = request.host or before.host, request.port or before.port
    check_host(host, request.trust_network)
    # The database may be another one, or empty: deploy anew.
    return Running(host, port, database, workers=before.workers)


def _start_server(
    running: Running, home: Path, request: ServiceRequest, say: Say
) -> None:
    if not lives(home, "server"):
        # The worker of a killed server may have turned to another address.
        stop(home, "worker")
        if not port_is_free(running.host, running.port):
            other = (
                "another Prefect server" if answers(running.url) else "another program"
            )
            raise InputError(
                f"Port {running.port} of {running.host} is taken by {other}. Choose "
                f"another: modelgap up --port {running.port + 1}."
            )
        say(f"starting the server on port {running.port}")
        env = server_environment(running, home, request.database)
        start(home, "server", server_command(running), env)
        write_running(home, running)

    def ready() -> bool:
        if not lives(home, "server"):
            raise RunError(f"The server ended at once; see {home}/server.log.")
        return answers(running.url)

    wait_until(ready, _PATIENCE, f"The server does not answer; see {home}/server.log.")


def server_command(running: Running) -> list[str]:
    """Return the command line of the server; it holds no key and no password.

    It is that of `prefect server start`, for the application with guard and pages.
    """
    command = [sys.executable, "-P", "-m", "uvicorn", "--factory", "--log-level"]
    command += ["warning", "--no-proxy-headers", "flows.service.serve:app"]
    command += ["--ws-max-size", str(_MESSAGE)]
    return [*command, "--host", running.host, "--port", str(running.port)]


def _deploy(
    running: Running,
    home: Path,
    request: ServiceRequest,
    client: SyncPrefectClient,
    say: Say,
) -> Running:
    version = deployed_as(request)
    if running.deployed != version:
        say(f"deploying {PROJECT if request.project else 'prefect.yaml'}")
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
        running = replace(running, deployed=version)
    write_running(home, running)
    return running


def start_every(
    client: SyncPrefectClient,
    deployment: str,
    seconds: int,
    parameters: dict | None = None,
) -> None:
    """Replace the schedule of --every of a deployment; 0 s removes it."""
    target = client.read_deployment_by_name(deployment)
    for old in target.schedules:
        if old.slug == _EVERY:
            client.delete_deployment_schedule(target.id, old.id)
    if seconds:
        new = DeploymentScheduleCreate(
            schedule=IntervalSchedule(interval=seconds),
            active=True,
            slug=_EVERY,
            parameters=parameters or {},
        )
        client.create_deployment_schedules(target.id, [new])


def stale_rule() -> dict:
    """Return the automation that closes flow runs without heartbeat.

    A suspended run, which waits for an answer, has no process and no heartbeat.
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
        # Two heartbeats may get lost, and a busy machine is late.
        "within": 4 * BEAT,
    }
    action = {
        "type": "change-flow-run-state",
        "state": "CRASHED",
        "name": "Crashed",
        "message": f"No sign of life for {4 * BEAT} s.",
    }
    about = "A killed process cannot report its end."
    rule = {"name": _STALE, "enabled": True, "description": about}
    return rule | {"trigger": trigger, "actions": [action]}


def down(home: Path, wait: float, say: Say) -> Running | None:
    """Wait for flow runs, then stop worker and server; schedules and history stay.

    Args:
        wait: Longest time for flow runs to finish [s]; then they are cancelled.
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
    """Wait for flow runs; let the worker cancel the remaining ones, and mark them."""

    def wait_for_runs(seconds: float) -> list:
        until = monotonic() + seconds
        while (active := api.active_runs(client)) and monotonic() < until:
            sleep(0.5)
        return active

    def mark(run, kind: StateType) -> None:
        state = State(type=kind, name=kind.value.title(), message=ENDED)
        client.set_flow_run_state(run.id, state, force=True)

    if active := api.active_runs(client):
        say(f"waiting up to {wait:g} s for {len(active)} flow run(s) to end")
    remaining = wait_for_runs(wait)
    for run in remaining:
        mark(run, StateType.CANCELLING)
    wait_for_runs(_CANCEL if lives(home, "worker") else 0.0)
    stop(home, "worker")
    for run in remaining:
        mark(run, StateType.CRASHED)
        say(f"ended: {run.name}")


def stay(store: Path, say: Say) -> None:
    """Return after Ctrl-C or SIGTERM, with everything stopped.

    Raises:
        RunError: If server or worker have ended; the service manager starts us again.
    """
    home, ended = prefect_home(store), Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: ended.set())
    while not ended.wait(1.0):
        running = read_running(home)
        if running is None or running.stopped:  # modelgap down, in another shell
            return
        if not all(lives(home, name) for name in PROCESSES):
            down(home, 0.0, say)
            raise RunError(f"Server or worker ended; see the logs in {home}.")
    down(home, _WAIT, say)
