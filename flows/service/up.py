"""Start and stop the server and the worker of a store, and deploy its flows.

To be imported under `flows.settings.build_prefect_environment`.
"""

import hashlib
import json
import os
import signal
import sqlite3
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from threading import Event
from time import monotonic, sleep
from uuid import UUID

import prefect
from prefect.blocks.webhook import Webhook
from prefect.client.orchestration import SyncPrefectClient
from prefect.client.schemas.actions import DeploymentScheduleCreate
from prefect.client.schemas.filters import FlowRunFilter, WorkPoolFilter
from prefect.client.schemas.objects import State, StateType
from prefect.client.schemas.schedules import IntervalSchedule
from prefect.events import AutomationCore, DeploymentEventTrigger
from prefect.events.actions import CallWebhook, SendNotification
from prefect.exceptions import ObjectNotFound
from prefect.flows import load_flow_from_entrypoint
from prefect.settings import PREFECT_API_AUTH_STRING, PREFECT_API_URL, temporary_settings
from prefect.utilities.callables import parameter_schema

from flows.pipelines import cancel_settled_proposals
from flows.project import (
    NOTICE,
    POOL,
    NotifyTable,
    Project,
    build_deployments,
    find_inbox_deployment,
    list_nightly_deployments,
)
from flows.service import api
from flows.service.api import is_server_up, wait_until
from flows.service.state import (
    BEAT,
    DATABASE,
    PORT,
    PROCESSES,
    RunningService,
    ServiceRequest,
    build_server_environment,
    build_worker_environment,
    check_host,
    format_database_label,
    is_process_running,
    lock_service,
    read_access_key,
    read_running,
    start_process,
    stop_process,
    write_running,
)
from flows.settings import PROJECT, ROOT, SHARED, port_is_free, prefect_home
from residual.errors import InputError, RunError

Say = Callable[[str], None]
# Bytes of a message on a WebSocket, also of one without the key; an event of Prefect
# has 1.5 MB at most.
_MESSAGE = 4 << 20
_PATIENCE = 600.0  # s; a first start on a busy machine
ENDED = "Ended by modelgap down. Its stored records are kept; the next run continues."
_ACTIVE = ("PENDING", "RUNNING", "CANCELLING")
_WAIT = 60.0  # s for flow runs to finish after SIGTERM
_CANCEL = 30.0  # s for the worker to cancel the remaining ones
# The SQL of an empty history of the Prefect that is installed.
_SCHEMA = Path(__file__).with_name(f"prefect-{prefect.__version__}.sql")


def start_service(request: ServiceRequest, say: Say) -> tuple[RunningService, bool]:
    """Start what does not run yet, and keep what runs.

    Returns:
        What runs now, and whether all of it ran before.
    """
    home, project = prefect_home(request.store), request.project
    with lock_service(home):
        running = _settled(request, read_running(home), home)
        version = hash_deployments(project)
        complete = (
            all(is_process_running(home, name) for name in PROCESSES)
            and running == read_running(home)
            and running.deployed == version
            and is_server_up(running.url)
        )
        if complete and request.every is None:
            return running, True
        _start_server(running, home, request, say)
        key = read_access_key(home)
        with api.Api(running.url, key).client() as client:
            api.create_work_pool(client, running.workers)
            if not is_process_running(home, "worker"):
                env = build_worker_environment(running, request.store, home)
                command = ["-m", "prefect", "worker", "start", "--type", "process"]
                command = [sys.executable, *command, "--pool", POOL]
                start_process(home, "worker", command, env)
            if running.deployed != version:
                say(f"deploying {PROJECT if project else 'prefect.yaml'}")
                deploy(client, project, key)
                running = replace(running, deployed=version)
            write_running(home, running)
            if request.every is not None:
                for name in list_nightly_deployments(project):
                    schedule_every(client, name, request.every)
            if inbox := find_inbox_deployment(project):
                target = client.read_deployment_by_name(inbox)
                client.create_flow_run_from_deployment(target.id)
            cancel_settled_proposals(client, request.store)

            def online() -> bool:
                if not is_process_running(home, "worker"):
                    raise RunError(f"The worker exited at once; see {home}/worker.log.")
                return api.is_worker_online(client)

            why = f"The worker sends no heartbeat; see {home}/worker.log."
            wait_until(online, _PATIENCE, why)
        return running, False


def _settled(request: ServiceRequest, before: RunningService | None, home: Path) -> RunningService:
    """Return host, port, database and workers; InputError where they contradict."""
    database = format_database_label(request.database)
    if before is None:
        host, port = request.host or "127.0.0.1", request.port or PORT
        return RunningService(host, port, database, workers=request.workers or 1)
    served = f"{request.store} is already served at {before.ui}"
    serves = is_process_running(home, "server")
    for option, value, now in (
        ("--host", request.host, before.host),
        ("--port", request.port, before.port),
    ):
        if serves and value not in (None, now):
            raise InputError(f"{served}, not with {option} {value}. Stop it first: modelgap down.")
    if database != before.database:
        if any(is_process_running(home, name) for name in PROCESSES):
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
    return RunningService(host, port, database, workers=before.workers)


def _start_server(running: RunningService, home: Path, request: ServiceRequest, say: Say) -> None:
    if not is_process_running(home, "server"):
        # The worker of a killed server may have turned to another address.
        stop_process(home, "worker")
        if not port_is_free(running.host, running.port):
            other = "another Prefect server" if is_server_up(running.url) else "another program"
            raise InputError(
                f"Port {running.port} of {running.host} is taken by {other}. Choose "
                f"another: modelgap up --port {running.port + 1}."
            )
        say(f"starting the server on port {running.port}")
        if request.database is None:
            create_history(home)
        env = build_server_environment(running, home, request.database)
        start_process(home, "server", build_server_command(running), env)
        write_running(home, running)

    def ready() -> bool:
        if not is_process_running(home, "server"):
            raise RunError(f"The server exited at once; see {home}/server.log.")
        return is_server_up(running.url)

    wait_until(ready, _PATIENCE, f"The server does not answer; see {home}/server.log.")


def create_history(home: Path) -> None:
    """Create the SQLite database of a new store as Prefect's migrations leave it.

    All 113 of them take 9 s of processor time. Where we have no file of the version
    that is installed, the server runs them; later ones it runs in any case.
    """
    database, draft = home / "prefect.db", home / "prefect.db.new"
    if database.exists() or not _SCHEMA.is_file():
        return
    draft.unlink(missing_ok=True)
    connection = sqlite3.connect(draft)
    connection.executescript(_SCHEMA.read_text(encoding="utf-8"))
    connection.close()
    draft.rename(database)


def build_server_command(running: RunningService) -> list[str]:
    """Return the command line of the server; it holds no key and no password.

    It is that of `prefect server start`, for the application with guard and pages.
    """
    command = [sys.executable, "-P", "-m", "uvicorn", "--factory", "--log-level"]
    command += ["warning", "--no-proxy-headers", "flows.service.access_guard:app"]
    command += ["--ws-max-size", str(_MESSAGE)]
    return [*command, "--host", running.host, "--port", str(running.port)]


def stop_service(home: Path, wait: float, say: Say) -> RunningService | None:
    """Wait for flow runs, then stop worker and server; schedules and history stay.

    Args:
        wait: Longest time for flow runs to finish [s]; then they are cancelled.
    """
    with lock_service(home):
        running = read_running(home)
        if running is None or not any(is_process_running(home, name) for name in PROCESSES):
            return None
        if is_process_running(home, "server") and is_server_up(running.url):
            with api.Api(running.url, read_access_key(home)).client() as client:
                api.create_work_pool(client, running.workers, paused=True)
                _finish_runs(client, home, wait, say)
        for name in reversed(PROCESSES):
            stop_process(home, name)
        # Port and database are those of the next start; not who may reach it.
        write_running(home, replace(running, host="127.0.0.1", stopped=True))
        return running


def _finish_runs(client: SyncPrefectClient, home: Path, wait: float, say: Say) -> None:
    """Wait for flow runs; let the worker cancel the remaining ones, and mark them."""
    ours = WorkPoolFilter(name={"any_": [POOL]})
    active = FlowRunFilter(state={"type": {"any_": _ACTIVE}})

    def wait_for_runs(seconds: float) -> list:
        until = monotonic() + seconds
        while True:
            runs = client.read_flow_runs(flow_run_filter=active, work_pool_filter=ours)
            if not runs or monotonic() >= until:
                return runs
            sleep(0.5)

    def mark(run, kind: StateType) -> None:
        state = State(type=kind, name=kind.value.title(), message=ENDED)
        client.set_flow_run_state(run.id, state, force=True)

    if runs := wait_for_runs(0.0):
        say(f"waiting up to {wait:g} s for {len(runs)} flow run(s) to end")
    remaining = wait_for_runs(wait)
    for run in remaining:
        mark(run, StateType.CANCELLING)
    wait_for_runs(_CANCEL if is_process_running(home, "worker") else 0.0)
    stop_process(home, "worker")
    for run in remaining:
        mark(run, StateType.CRASHED)
        say(f"ended: {run.name}")


def wait_for_stop_signal(store: Path, say: Say) -> None:
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
        if not all(is_process_running(home, name) for name in PROCESSES):
            stop_service(home, 0.0, say)
            raise RunError(f"Server or worker ended; see the logs in {home}.")
    stop_service(home, _WAIT, say)


_EVERY = "every"  # slug of the schedule of --every
_STALE = "close flow runs without a sign of life"
_NOTIFY = "notify people of alarms, findings, refused logs and proposals"
_BLOCK = "modelgap-notify"  # name of the block with the address of the webhook
# What a chat shows is "text"; the other keys are for programs.
_NOTICE_TEXT = """{%- set p = event.payload -%}
{{ dict(p, text=[p.title, p.text, p.page] | select | join("\n")) | tojson }}"""


def hash_deployments(project: Project | None) -> str:
    """Return a hash of the deployments, to know whether a server has those of now."""
    content = json.dumps(build_deployments(project)), str(ROOT), _read_notify(project)
    return hashlib.sha256(repr(content).encode()).hexdigest()[:20]


def _read_notify(project: Project | None) -> tuple[NotifyTable, str] | None:
    """Return what [notify] says, and the address of its webhook."""
    if project is None or project.table.notify is None:
        return None
    notify = project.table.notify
    address = os.environ.get(notify.webhook, "")
    if notify.webhook and not address.startswith(("http://", "https://")):
        raise InputError(
            f"{PROJECT}: [notify] webhook: the environment variable {notify.webhook} "
            f"has {'another value' if address else 'no value'}, expected the address "
            f"of the webhook. Set it, then: modelgap up."
        )
    return notify, address


def deploy(client: SyncPrefectClient, project: Project | None, key: str) -> None:
    """Create or replace all deployments and automations; remove other ones of ours."""
    notify = _build_notify_rule(client, project, key)  # may be refused
    kept = {_deploy(client, each) for each in build_deployments(project)["deployments"]}
    for each in client.read_deployments():
        if POOL in (each.tags or ()) and each.id not in kept:
            client.delete_deployment(each.id)
    _replace_rule(client, _STALE, _build_stale_run_rule())
    _replace_rule(client, _NOTIFY, notify)


def _deploy(client: SyncPrefectClient, each: dict) -> UUID:
    flow = load_flow_from_entrypoint(each["entrypoint"])
    limit = each.get("concurrency_limit") or {}
    when = ("cron", "timezone")
    schedules = [
        {"schedule": {key: each.pop(key) for key in when}, **each}
        for each in map(dict, each.get("schedules", ()))
    ]
    id = client.create_deployment(
        client.create_flow(flow),
        each["name"],
        schedules=schedules,
        concurrency_limit=limit.get("limit"),
        concurrency_options={k: v for k, v in limit.items() if k != "limit"} or None,
        parameters=each.get("parameters"),
        description=each["description"],
        work_pool_name=POOL,
        tags=each["tags"],
        entrypoint=each["entrypoint"],
        parameter_openapi_schema=parameter_schema(flow).model_dump(exclude_unset=True),
        enforce_parameter_schema=True,
        pull_steps=[],  # those of `prefect deploy` name a folder that may be gone
        job_variables={"working_dir": str(SHARED)},  # where the examples are
    )
    client.delete_resource_owned_automations(f"prefect.deployment.{id}")
    for trigger in each.get("triggers", ()):
        rule = DeploymentEventTrigger(name=f"start {each['name']}", **trigger)
        rule.set_deployment_id(id)
        client.create_automation(rule.as_automation())
    return id


def schedule_every(
    client: SyncPrefectClient, deployment: str, seconds: int, parameters: dict | None = None
) -> None:
    """Replace the schedule of --every of a deployment; 0 s removes it."""
    target = client.read_deployment_by_name(deployment)
    for old in target.schedules:
        if old.slug == _EVERY:
            client.delete_deployment_schedule(target.id, old.id)
    if seconds:
        when, given = IntervalSchedule(interval=seconds), parameters or {}
        new = DeploymentScheduleCreate(schedule=when, slug=_EVERY, parameters=given)
        client.create_deployment_schedules(target.id, [new])


def _replace_rule(client: SyncPrefectClient, name: str, rule: dict | None) -> None:
    for old in client.read_automations_by_name(name):
        client.delete_automation(old.id)
    if rule:
        rule["trigger"] |= {"type": "event", "threshold": 1}
        client.create_automation(AutomationCore.model_validate(rule | {"name": name}))


def _build_stale_run_rule() -> dict:
    """Return the automation that closes flow runs without heartbeat.

    A suspended run, which waits for an answer, has no process and no heartbeat.
    """
    rests = ("Completed", "Failed", "Cancelled", "Crashed", "Suspended", "Paused")
    beat = "prefect.flow-run.heartbeat"
    trigger = {
        "match": {"prefect.resource.id": "prefect.flow-run.*"},
        "after": [beat],
        "expect": [beat, *(f"prefect.flow-run.{rest}" for rest in rests)],
        "for_each": ["prefect.resource.id"],
        "posture": "Proactive",
        # Two heartbeats may get lost, and a busy machine is late.
        "within": 4 * BEAT,
    }
    message = f"No heartbeat for {4 * BEAT} s."
    close = {"type": "change-flow-run-state", "state": "CRASHED", "message": message}
    about = "A killed process cannot report its end."
    action = {**close, "name": "Crashed"}
    return {"description": about, "trigger": trigger, "actions": [action]}


def _build_notify_rule(client: SyncPrefectClient, project: Project | None, key: str) -> dict | None:
    """Return the automation of [notify]; None where the project has none."""
    if (asked := _read_notify(project)) is None:
        return None
    (notify, address), actions = asked, []
    if notify.block:
        kind, _, name = notify.block.partition("/")
        try:
            id = client.read_block_document_by_name(name, kind).id
        except ObjectNotFound:
            raise InputError(
                f"{PROJECT}: [notify] block: this server has no '{notify.block}'. "
                "Create it in Prefect's page under Blocks, then: modelgap up."
            ) from None
        title, text = "{{ event.payload.title }}", "{{ event.payload.text }}"
        text += "\n{{ event.payload.page }}"
        actions.append(SendNotification(block_document_id=id, subject=title, body=text))
    if notify.webhook:
        server = {PREFECT_API_URL: str(client.api_url), PREFECT_API_AUTH_STRING: key}
        block = Webhook(url=address, headers={"Content-Type": "application/json"})
        with temporary_settings(server):  # a block takes them from nowhere else
            id = block.save(_BLOCK, overwrite=True)
        actions.append(CallWebhook(block_document_id=id, payload=_NOTICE_TEXT))
    expect = [f"{NOTICE}.{kind}" for kind in notify.kinds]
    trigger = {"expect": expect, "posture": "Reactive", "within": 0}
    return {"trigger": trigger, "actions": actions}
