"""What is asked of a running Prefect server, as plain HTTP: no slow import."""

import json
from collections.abc import Mapping
from datetime import datetime
from time import sleep
from typing import Any
from urllib.error import HTTPError
from urllib.request import Request, urlopen

from flows.errors import RunError

POOL = "modelgap"
_TRIES = 8
ACTIVE = ("PENDING", "RUNNING", "CANCELLING")


def ask(
    url: str, path: str, body: Any = None, method: str | None = None, wait: float = 60
) -> Any:
    """Send one request to the API and return its answer.

    Args:
        url: Address of the API.
        path: Below it, such as "/flows/filter".
        body: What to send as JSON; None for nothing.
        method: GET without a body, POST with one, unless given.
        wait: How long to wait for the answer [s].

    Raises:
        RunError: If the server does not answer or refuses.
    """
    data = None if body is None else json.dumps(body).encode()
    headers = {"Content-Type": "application/json"}
    request = Request(url.rstrip("/") + path, data, headers, method=method)
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
            said = " ".join(error.read().decode(errors="replace").split())[:300]
            words = f"The server refused {path} ({error.code}): {said}"
            raise RunError(words) from error
        except (OSError, ValueError) as error:
            raise RunError(f"The server at {url} does not answer: {error}") from error
    return None


def is_there(url: str, path: str) -> bool:
    """Return whether the server knows what a path names.

    Raises:
        RunError: If the server does not answer.
    """
    try:
        ask(url, path)
    except RunError as error:
        if isinstance(error.__cause__, HTTPError) and error.__cause__.code == 404:
            return False
        raise
    return True


def open_pool(url: str, paused: bool = False) -> None:
    """Make the work pool if it is not there, and let it give out work or not.

    Args:
        url: Address of the API.
        paused: Whether it shall give out nothing for now.
    """
    if not is_there(url, f"/work_pools/{POOL}"):
        ask(url, "/work_pools/", {"name": POOL, "type": "process"})
    ask(url, f"/work_pools/{POOL}", {"is_paused": paused}, "PATCH")


def active_runs(url: str) -> list[dict]:
    """Return the flow runs of our pool that are said to run."""
    wanted = {
        "flow_runs": {"state": {"type": {"any_": list(ACTIVE)}}},
        "work_pools": {"name": {"any_": [POOL]}},
    }
    return ask(url, "/flow_runs/filter", wanted)


def end_run(url: str, id: str, why: str) -> None:
    """Mark a flow run as crashed, which also frees the place that it held.

    Args:
        url: Address of the API.
        id: Of the flow run.
        why: For whoever reads its history.
    """
    state = {"type": "CRASHED", "name": "Crashed", "message": why}
    ask(url, f"/flow_runs/{id}/set_state", {"state": state, "force": True})


def workers_online(url: str) -> set[str]:
    """Return the names of the workers that have reported lately."""
    path = f"/work_pools/{POOL}/workers/filter"
    if not is_there(url, f"/work_pools/{POOL}"):
        return set()
    return {w["name"] for w in ask(url, path, {}) if w.get("status") == "ONLINE"}


def deployments(url: str) -> list[Mapping]:
    """Return all deployments as "flow/name", each with when it is due next."""
    flows = {f["id"]: f["name"] for f in ask(url, "/flows/filter", {})}
    due = _due(url)
    found = [
        {
            "name": f"{flows.get(each['flow_id'], '?')}/{each['name']}",
            "id": each["id"],
            "paused": each["paused"],
            "schedules": [s for s in each["schedules"] if s["active"]],
            "due": due.get(each["id"]),
        }
        for each in ask(url, "/deployments/filter", {})
    ]
    return sorted(found, key=lambda d: d["name"])


def last_runs(url: str, most: int = 10) -> list[Mapping]:
    """Return the latest flow runs that have begun or ended, latest first."""
    wanted = {
        "flow_runs": {"state": {"type": {"not_any_": ["SCHEDULED"]}}},
        "sort": "START_TIME_DESC",
        "limit": most,
    }
    keys = ("id", "name", "start_time", "end_time", "total_run_time")
    return [
        {k: run[k] for k in keys}
        | {"state": run["state_name"], "message": (run["state"] or {}).get("message")}
        for run in ask(url, "/flow_runs/filter", wanted)
    ]


def _due(url: str) -> dict[str, datetime]:
    wanted = {
        "flow_runs": {"state": {"type": {"any_": ["SCHEDULED"]}}},
        "sort": "EXPECTED_START_TIME_ASC",
        "limit": 200,
    }
    due: dict[str, datetime] = {}
    for run in ask(url, "/flow_runs/filter", wanted):
        if run["deployment_id"] and run["expected_start_time"]:
            when = datetime.fromisoformat(run["expected_start_time"])
            due.setdefault(run["deployment_id"], when)
    return due
