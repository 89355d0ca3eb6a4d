"""Start, or complete, what runs for a store, and stop it: server, pool and workers.

What has stopped has lost nothing: it waits for flow runs, and marks those that it ends.
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

from flows.project.deployments import deployments, every_of, inbox_of
from flows.service import api
from flows.service.api import answers
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
    Process,
    Running,
    flow_processes,
    one_at_a_time,
    read_running,
    start,
    stop,
    store_key,
    worker_name,
    write_running,
)
from flows.settings import PROJECT, ROOT, port_is_free, prefect_home
from residual.errors import InputError, RunError

GONE = "Its process is gone; closed when modelgap up found it."
Say = Callable[[str], None]
# Bytes of a message on a WebSocket, held before anybody has shown a key; an event of
# Prefect has 1.5 MB at most.
_MESSAGE = 4 << 20
_EVERY = "every"  # slug of the schedule of --every
_PATIENCE = 600.0  # s; the first start makes the database, on a busy machine slowly
_WATCH = "close flow runs without a sign of life"


def up(request: ServiceRequest, say: Say) -> tuple[Running, bool]:
    """Bring up what does not run yet; what runs is left as it is.

    Returns:
        What runs now, and whether all of it ran before.
    """
    home = prefect_home(request.store)
    with one_at_a_time(home):
        before = read_running(home)
        running = _agreed(request, before)
        count = _count(request, before)
        if _complete(running, request, count) and request.every is None:
            return running, True
        running = _with_server(running, home, request, say)
        to = api.Api(running.url, store_key(home))
        api.open_pool(to)
        for closed in close_stale(to):
            say(f"closed, since nobody runs it any more: {closed}")
        running = _with_workers(running, home, request, count)
        running = _deployed(running, home, request, say)
        if request.every is not None:
            for name in every_of(request.project):
                start_every(to, name, request.every)
        watch_for_stale(to)
        if inbox := inbox_of(request.project):
            api.start_flow(to, inbox)
        _wait(
            lambda: _online(running, to), f"No worker reports; see {home}/worker-1.log."
        )
        return running, False


def deployed_as(request: ServiceRequest) -> str:
    """Return what tells whether the deployments on a server are those of now."""
    content = _content(request) + str(ROOT).encode()
    return hashlib.sha256(content).hexdigest()[:20]


def _content(request: ServiceRequest) -> bytes:
    # JSON is YAML too.
    return json.dumps(deployments(request.project), indent=1).encode()


def _agreed(request: ServiceRequest, before: Running | None) -> Running:
    """Return the state to start from; InputError where it contradicts the wish."""
    database = shown_database(request.database)
    if before is None:
        host, port = request.host or "127.0.0.1", request.port or PORT
        return Running(host, port, database)
    asked = {"--host": request.host, "--port": request.port}
    has = {"--host": before.host, "--port": before.port}
    for name, value in asked.items():
        if before.server and value not in (None, has[name]):
            raise InputError(
                f"{request.store} is already served at {before.ui}, not with {name} "
                f"{value}. Stop it first: modelgap down."
            )
    if database != before.database and before.alive:
        raise InputError(
            f"{request.store} is already served at {before.ui} with its history in "
            f"{before.database}, not in {database}. Stop it first: modelgap down."
        )
    if before.server:
        return before
    if database != before.database and request.database is None:
        raise InputError(
            f"The history of {request.store} is in {before.database}. Give its "
            f"address: ${DATABASE}."
        )
    host, port = request.host or before.host, request.port or before.port
    check_host(host, request.trust_network)
    # The database may be another one, or have been emptied: deployed anew.
    return Running(host, port, database, processes=before.processes)


def _count(request: ServiceRequest, before: Running | None) -> int:
    known = len([p for p in before.processes if p.name != "server"]) if before else 0
    alive = len(before.workers) if before else 0
    if request.workers is not None and request.workers < alive:
        raise InputError(
            f"{alive} workers run for {request.store}, more than --workers "
            f"{request.workers}. Stop them first: modelgap down."
        )
    return request.workers or known or 1


def _complete(running: Running, request: ServiceRequest, count: int) -> bool:
    return (
        running.server is not None
        and len(running.workers) == count
        and running.deployed == deployed_as(request)
        and answers(running.url)
    )


def _with_server(
    running: Running, home: Path, request: ServiceRequest, say: Say
) -> Running:
    server = running.server
    if server is None:
        # Workers of a server that was killed may have turned to another address.
        stop(running.workers)
        _check_port(running)
        say(f"starting the server on port {running.port}")
        env = server_environment(running, home, request.database)
        log = home / "server.log"
        server = start("server", server_command(running), env, log, umask=0o077)
        running = replace(running, processes=(server,))
        write_running(home, running)
    _wait_for_server(running, server, home)
    return running


def server_command(running: Running) -> list[str]:
    """Return the command line of the server; it has no key and no password."""
    command = [sys.executable, "-P", "-m", "uvicorn", "--factory", "--log-level"]
    command += ["warning", "--no-proxy-headers", "flows.service.serve:app"]
    command += ["--ws-max-size", str(_MESSAGE)]
    return [*command, "--host", running.host, "--port", str(running.port)]


def _check_port(running: Running) -> None:
    if port_is_free(running.host, running.port):
        return
    what = "another Prefect server" if answers(running.url) else "another program"
    raise InputError(
        f"Port {running.port} of {running.host} is taken by {what}. Choose another: "
        f"modelgap up --port {running.port + 1}."
    )


def _wait_for_server(running: Running, server: Process, home: Path) -> None:
    def ready() -> bool:
        if not server.lives:
            raise RunError(f"The server ended at once; see {home}/server.log.")
        return answers(running.url)

    _wait(ready, f"The server does not answer; see {home}/server.log.")


def _with_workers(
    running: Running, home: Path, request: ServiceRequest, count: int
) -> Running:
    env = worker_environment(running, request.store, home)
    taken = {p.name for p in running.workers}
    free = [n for n in (f"worker-{i}" for i in range(1, count + 1)) if n not in taken]
    command = [sys.executable, "-m", "prefect", "worker", "start", "--type", "process"]
    command += ["--pool", api.POOL, "--name"]
    made = [
        start(name, [*command, worker_name(name)], env, home / f"{name}.log")
        for name in free[: count - len(taken)]
    ]
    server = running.server
    kept = (*([server] if server else []), *running.workers, *made)
    running = replace(running, processes=kept)
    write_running(home, running)
    return running


def _deployed(
    running: Running, home: Path, request: ServiceRequest, say: Say
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
        to = api.Api(running.url, store_key(home))
        api.keep_deployments(to, deployments(request.project)["deployments"])
        running = replace(running, deployed=wish)
        write_running(home, running)
    return running


def start_every(
    to: api.Api, deployment: str, seconds: int, parameters: dict | None = None
) -> None:
    """Give a deployment a further schedule from now on, instead of the one before.

    Args:
        seconds: Time between two starts [s]; 0 for no such schedule any more.
    """
    known = api.ask(to, f"/deployments/name/{deployment}")
    place = f"/deployments/{known['id']}/schedules"
    for old in known["schedules"]:
        if old.get("slug") == _EVERY:
            api.ask(to, f"{place}/{old['id']}", method="DELETE")
    if seconds:
        when = {"interval": float(seconds)}
        new = {"schedule": when, "active": True, "slug": _EVERY}
        api.ask(to, place, [{**new, "parameters": parameters or {}}])


def close_stale(to: api.Api) -> list[str]:
    """Close flow runs of our pool that no process of this machine runs.

    Those of workers on other machines are left to `watch_for_stale`, which needs no
    look at processes.
    """
    alive, closed, here = flow_processes(), [], worker_name("")
    if any(not name.endswith(here) for name in api.workers_online(to)):
        return closed
    for run in api.active_runs(to):
        if run["id"] not in alive:
            api.end_run(to, run["id"], GONE)
            closed.append(run["name"])
    return closed


def watch_for_stale(to: api.Api) -> None:
    """Let the server itself close a flow run that gives no sign of life any more."""
    rule = stale_rule()
    filters = {"automations": {"name": {"any_": [_WATCH]}}}
    known = api.ask(to, "/automations/filter", filters)
    expected = set(rule["trigger"]["expect"])
    if known and set(known[0]["trigger"]["expect"]) == expected:
        return
    for old in known:  # with another rule
        api.ask(to, f"/automations/{old['id']}", method="DELETE")
    api.ask(to, "/automations/", rule)


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


def _online(running: Running, to: api.Api) -> bool:
    for worker in running.processes:
        if not worker.lives:
            raise RunError(f"{worker.name} ended at once; see {worker.name}.log.")
    names = {worker_name(p.name) for p in running.workers}
    return names <= api.workers_online(to)


def _wait(ready: Callable[[], bool], otherwise: str) -> None:
    begun = monotonic()
    while not ready():
        if monotonic() - begun > _PATIENCE:
            raise RunError(otherwise)
        sleep(0.25)


# Stop what runs for a store, or stay beside it until then, and lose nothing of it.


ENDED = "Ended by modelgap down. What it had stored is kept; the next run goes on."
_WAIT = 60.0  # s that flow runs may go on after the request to stop


def down(home: Path, wait: float, say: Say) -> Running | None:
    """Let flow runs end, then stop workers and server; schedules and history stay.

    Args:
        wait: How long flow runs may go on [s]; then they are ended and marked.
    """
    with one_at_a_time(home):
        running = read_running(home)
        if running is None or not running.alive:
            return None
        if answers(running.url) and running.server:
            to = api.Api(running.url, store_key(home))
            _finish_runs(running, to, wait, say)
        stop(running.workers)
        if running.server:
            stop([running.server])
        # Port and database are those of the next start; not who may reach it.
        write_running(home, replace(running, host="127.0.0.1", processes=()))
        return running


def _finish_runs(running: Running, to: api.Api, wait: float, say: Say) -> None:
    """Give out no new work, wait for what runs, end and mark what is left."""
    api.open_pool(to, paused=True)
    until, announced = monotonic() + wait, False
    while (active := _active(to)) and monotonic() < until:
        if not announced:
            say(f"waiting up to {wait:g} s for {len(active)} flow run(s) to end")
            announced = True
        sleep(0.5)
    # Workers first, or they would report the end of their flows in words of their own.
    stop(running.workers)
    left = [p for processes in active.values() for p in processes]
    stop(left)
    for run in api.active_runs(to):
        if run["id"] in active:
            api.end_run(to, run["id"], ENDED)
            say(f"ended: {run['name']}")


def _active(to: api.Api) -> dict[str, list[Process]]:
    """Return the processes on this machine of flow runs of our pool, by id."""
    try:
        ids = {run["id"] for run in api.active_runs(to)}
    except RunError:
        return {}
    return {id: ps for id, ps in flow_processes().items() if id in ids}


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
        if running is None or not running.processes:  # modelgap down, from elsewhere
            return
        if len(running.alive) < len(running.processes):
            down(home, 0.0, say)
            raise RunError(f"Server or worker ended; see the logs in {home}.")
    down(home, _WAIT, say)
