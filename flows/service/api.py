"""What is asked of a running Prefect server, as plain HTTP, and whether it is well."""

import json
from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from time import sleep
from typing import Any
from urllib.error import HTTPError
from urllib.request import Request, urlopen

from flows.report.night import look, questions
from flows.report.night.look import FlowRun, History, Past
from flows.service.state import Running, read_running, store_key, worker_name
from residual.errors import RunError
from warehouse.query.store import open_store

POOL = "modelgap"
_TRIES = 8
ACTIVE = ("PENDING", "RUNNING", "CANCELLING")
_AT_ONCE = 200  # that the server gives at once
# Levels of logs that are warnings; what is worse has failed, and says so there.
_WARNINGS = {"ge_": 30, "le_": 39}
_LONGEST = 300  # characters of one
_PAGE_WAIT = 10.0  # s
INBOX = "inbox"  # name of the flow that looks into inboxes


@dataclass(frozen=True, slots=True)
class Api:
    """The API of a server, and what opens it."""

    url: str
    key: str = field(repr=False)

    @property
    def headers(self) -> dict[str, str]:
        """What every request has to carry."""
        shown = b64encode(self.key.encode()).decode()
        return {"Content-Type": "application/json", "Authorization": f"Basic {shown}"}


def ask(
    api: Api, path: str, body: Any = None, method: str | None = None, wait: float = 60
) -> Any:
    """Send one request to the API and return its answer.

    Args:
        path: Below it, such as "/flows/filter".
        body: What to send as JSON; None for nothing.
        method: GET without a body, POST with one, unless given.
        wait: How long to wait for the answer [s].
    """
    data = None if body is None else json.dumps(body).encode()
    place = api.url.rstrip("/") + path
    request = Request(place, data, api.headers, method=method)
    for left in range(_TRIES, 0, -1):
        try:
            with urlopen(request, timeout=wait) as reply:
                text = reply.read()
            return json.loads(text) if text else None
        except HTTPError as error:
            # Its database may be busy for a moment, above all after a start.
            if error.code >= 500 and left > 1:
                sleep(1)
                continue
            reason = " ".join(error.read().decode(errors="replace").split())[:300]
            words = f"The server refused {path} ({error.code}): {reason}"
            raise RunError(words) from error
        except (OSError, ValueError) as error:
            words = f"The server at {api.url} does not answer: {error}"
            raise RunError(words) from error
    return None


def answers(url: str | None) -> bool:
    """Return whether a Prefect server answers at the address of its API."""
    if not url:
        return False
    try:
        with urlopen(f"{url.rstrip('/')}/health", timeout=10) as reply:
            return reply.status == 200
    except (OSError, ValueError):
        return False


def opening_address(ui: str, key: str) -> str:
    """Return the address at which a browser gets the key: once, and not for long."""
    ticket = ask(Api(ui, key), "/open/ticket", {})["ticket"]
    return f"{ui}/open#{ticket}"


def is_there(api: Api, path: str) -> bool:
    """Return whether the server knows what a path names.

    Raises:
        RunError: If the server does not answer.
    """
    try:
        ask(api, path)
    except RunError as error:
        if isinstance(error.__cause__, HTTPError) and error.__cause__.code == 404:
            return False
        raise
    return True


def open_pool(api: Api, paused: bool = False) -> None:
    """Make the work pool if it is not there, and let it give out work or not."""
    if not is_there(api, f"/work_pools/{POOL}"):
        ask(api, "/work_pools/", {"name": POOL, "type": "process"})
    ask(api, f"/work_pools/{POOL}", {"is_paused": paused}, "PATCH")


def active_runs(api: Api) -> list[dict]:
    """Return the flow runs of our pool that are said to run."""
    pool = {"name": {"any_": [POOL]}}
    return _flow_runs(api, {"any_": list(ACTIVE)}, work_pools=pool)


def _flow_runs(
    api: Api, types: Mapping | None, wait: float = 60, **filters: Any
) -> list[dict]:
    """Return flow runs; with ``types`` those whose type of state is so filtered."""
    about = filters.pop("flow_runs", {}) | (
        {"state": {"type": types}} if types is not None else {}
    )
    return ask(api, "/flow_runs/filter", {**filters, "flow_runs": about}, wait=wait)


def end_run(api: Api, id: str, why: str) -> None:
    """Mark a flow run as crashed, which also frees the place that it held."""
    state = {"type": "CRASHED", "name": "Crashed", "message": why}
    ask(api, f"/flow_runs/{id}/set_state", {"state": state, "force": True})


def workers_online(api: Api) -> set[str]:
    """Return the names of the workers that have reported lately."""
    path = f"/work_pools/{POOL}/workers/filter"
    if not is_there(api, f"/work_pools/{POOL}"):
        return set()
    return {w["name"] for w in ask(api, path, {}) if w.get("status") == "ONLINE"}


def deployments(api: Api) -> list[Mapping]:
    """Return all deployments as "flow/name", each with when it is due next."""
    flows = {f["id"]: f["name"] for f in ask(api, "/flows/filter", {})}
    due = _due(api)
    found = [
        {
            "name": f"{flows.get(each['flow_id'], '?')}/{each['name']}",
            "id": each["id"],
            "paused": each["paused"],
            "schedules": [s for s in each["schedules"] if s["active"]],
            "due": due.get(each["id"]),
        }
        for each in ask(api, "/deployments/filter", {})
    ]
    return sorted(found, key=lambda d: d["name"])


def keep_deployments(api: Api, deployed: Sequence[Mapping]) -> None:
    """Remove deployments of ours that are not wanted any more."""
    ours = {(each["name"], each["entrypoint"]) for each in deployed}
    for each in ask(api, "/deployments/filter", {}):
        named = (each["name"], each["entrypoint"])
        if POOL in (each["tags"] or ()) and named not in ours:
            ask(api, f"/deployments/{each['id']}", method="DELETE")


def flows_but_inbox(api: Api) -> dict:
    """Return a filter of flows: all but the one that looks into inboxes.

    It does so every few minutes; among its runs those of the night would not be seen.
    """
    names = {flow["name"] for flow in ask(api, "/flows/filter", {})}
    return {"flows": {"name": {"any_": sorted(names - {INBOX})}}}


def last_runs(api: Api, most: int = 10) -> list[Mapping]:
    """Return the latest flow runs that have begun or ended, latest first.

    Starts that were cancelled, as one that comes while another runs is, have no result:
    they stand after all others, and only where there is room.
    """
    flows = flows_but_inbox(api)
    found = _runs(api, {"not_any_": ["SCHEDULED", "CANCELLED"]}, most, flows)
    left = most - len(found)
    return found + (_runs(api, {"any_": ["CANCELLED"]}, left, flows) if left else [])


def _runs(api: Api, types: Mapping, most: int, flows: Mapping) -> list[Mapping]:
    found = _flow_runs(api, types, sort="START_TIME_DESC", limit=most, **flows)
    keys = ("id", "name", "start_time", "end_time", "total_run_time")
    return [
        {k: run[k] for k in keys}
        | {"state": run["state_name"], "message": (run["state"] or {}).get("message")}
        for run in found
    ]


def _due(api: Api) -> dict[str, datetime]:
    order = {"sort": "EXPECTED_START_TIME_ASC", "limit": _AT_ONCE}
    due: dict[str, datetime] = {}
    for run in _flow_runs(api, {"any_": ["SCHEDULED"]}, **order):
        if run["deployment_id"] and run["expected_start_time"]:
            when = datetime.fromisoformat(run["expected_start_time"])
            due.setdefault(run["deployment_id"], when)
    return due


def start_flow(api: Api, deployment: str) -> None:
    """Start a deployment now, beside its schedule; a worker takes it in its turn.

    Raises:
        RunError: If the server does not answer or has no such deployment.
    """
    known = ask(api, f"/deployments/name/{deployment}")
    ask(api, f"/deployments/{known['id']}/create_flow_run", {"parameters": {}})


def past_of(to: Api) -> Past:
    """Return what tells of the flow runs of a time, and of what they warned of."""

    def past(begin: datetime, end: datetime) -> History | None:
        span = {"after_": _iso(begin), "before_": _iso(end)}
        logs = {
            "logs": {"level": _WARNINGS, "timestamp": span},
            "sort": "TIMESTAMP_ASC",
            "limit": _AT_ONCE,
        }
        try:
            found = _runs_between(to, span)
            warned = ask(to, "/logs/filter", logs, wait=_PAGE_WAIT)
        except RunError:
            return None
        names = {run["id"]: run["name"] for run in found}
        lines = [
            (names[line["flow_run_id"]], " ".join(line["message"].split())[:_LONGEST])
            for line in warned
            if line["flow_run_id"] in names
        ]
        return History(tuple(map(_flow_run, found)), tuple(dict.fromkeys(lines)))

    return past


def _runs_between(to: Api, span: Mapping) -> list[Mapping]:
    """Return the flow runs of a time, latest first.

    Of those of inboxes only what failed, and what refused a log.
    """
    begun: tuple[Mapping, Mapping] = (
        {"not_any_": ["SCHEDULED", "CANCELLED"]},
        flows_but_inbox(to),
    )
    failed = {"any_": ["FAILED", "CRASHED"]}, {}
    refused = None, {"flow_runs": {"name": {"like_": "refused"}}}
    order = {"sort": "START_TIME_DESC", "limit": _AT_ONCE}
    found: dict[str, Mapping] = {}
    for types, filters in (begun, failed, refused):
        about = {**filters.get("flow_runs", {}), "expected_start_time": span}
        own = {**filters, **order, "flow_runs": about}
        rows = _flow_runs(to, types, _PAGE_WAIT, **own)
        found |= {row["id"]: row for row in rows}
    return sorted(found.values(), key=_begun, reverse=True)


def _begun(run: Mapping) -> datetime:
    when = datetime.fromisoformat(run["start_time"] or run["expected_start_time"])
    return when.astimezone(UTC).replace(tzinfo=None)


def _flow_run(run: Mapping) -> FlowRun:
    return FlowRun(
        id=run["id"],
        name=run["name"],
        state=run["state_type"],
        begun=_begun(run),
        seconds=run["total_run_time"],
        message=(run["state"] or {}).get("message") or "",
    )


def _iso(when: datetime) -> str:
    return when.replace(tzinfo=UTC).isoformat()


# Whether what runs for a store is well.


_LATELY = timedelta(days=1)


@dataclass(frozen=True, slots=True)
class Status:
    """State of the service of one store."""

    running: Running | None  # what was started, None if nothing was
    server: bool = False  # whether the server answers
    # Each worker by name: "online", "starting" or "gone".
    workers: Mapping[str, str] | None = None
    # Each with when it is due (`deployments`).
    deployments: tuple[Mapping, ...] = ()
    runs: tuple[Mapping, ...] = ()  # the last flow runs (`last_runs`)
    # Logs that inboxes refused within a day, the latest first.
    refused: tuple[Mapping, ...] = ()

    @property
    def healthy(self) -> bool:
        """Whether the next schedule will fire and somebody will run it."""
        states = (self.workers or {}).values()
        online = bool(states) and all(state == "online" for state in states)
        return self.server and online and bool(self.deployments)

    @property
    def pages(self) -> Mapping[str, str]:
        """Addresses of the pages over the store, none where no server answers."""
        if self.running is None or not self.server:
            return {}
        first = self.running.pages
        return {"night": f"{first}/night/latest.html", "reports": f"{first}/index.html"}

    def document(self) -> dict:
        """Return it as JSON has it; times are UTC in ISO 8601."""
        running = self.running
        return {
            "schema": 1,
            "healthy": self.healthy,
            "ui": running.ui if running else None,
            "pages": dict(self.pages),
            "api": running.url if running else None,
            "database": running.database if running else None,
            "server": self.server,
            "workers": dict(self.workers or {}),
            "deployments": [
                {
                    "name": d["name"],
                    "paused": d["paused"],
                    "schedules": len(d["schedules"]),
                    "due": d["due"].isoformat() if d["due"] else None,
                }
                for d in self.deployments
            ],
            "runs": list(self.runs),
            "refused": [
                {"robot": r["robot"], "why": r["why"], "at": r["created"].isoformat()}
                for r in self.refused
            ],
        }


def status(home: Path, most: int = 10) -> Status:
    """Look at everything that belongs to a store."""
    running = read_running(home)
    if running is None or not running.processes:
        return Status(None)
    processes = [p for p in running.processes if p.name != "server"]
    gone = {p.name: "starting" if p.lives else "gone" for p in processes}
    if running.server is None or not answers(running.url):
        return Status(running, workers=gone)
    to = Api(running.url, store_key(home))
    try:
        online, due = workers_online(to), tuple(deployments(to))
        runs = tuple(last_runs(to, most))
    except RunError:
        return Status(running, workers=gone)
    workers = {
        p.name: "online" if p.lives and worker_name(p.name) in online else gone[p.name]
        for p in processes
    }
    return Status(running, True, workers, due, runs, _refused(home.parent))


def _refused(store: Path) -> tuple[Mapping, ...]:
    since = datetime.now(UTC).replace(tzinfo=None) - _LATELY
    with open_store(store) as opened:
        rows = look.ask(opened, questions.REFUSED)
    return tuple(row for row in rows if row["created"] and row["created"] > since)
