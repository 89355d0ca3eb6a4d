"""Queries to the Prefect server of a store, and the status of the service.

To be imported under `flows.settings.build_prefect_environment`.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from time import monotonic, sleep

import httpx
from prefect.client.orchestration import SyncPrefectClient
from prefect.client.schemas.actions import WorkPoolCreate, WorkPoolUpdate
from prefect.client.schemas.filters import FlowFilter, FlowRunFilter
from prefect.client.schemas.sorting import FlowRunSort
from prefect.exceptions import ObjectAlreadyExists, ObjectNotFound, PrefectException

from flows.project import POOL
from flows.report.store_index import INDEX, list_refused_logs
from flows.service.state import PROCESSES, is_process_running, read_access_key, read_running
from residual.errors import RunError

INBOX = "inbox"  # name of the flow of the inboxes
_AT_ONCE = 200  # rows of one answer of the server
_LISTED = 10  # flow runs of the status
_LATELY = timedelta(days=1)
_WAIT = 60.0  # s for an answer


@dataclass(frozen=True, slots=True)
class Api:
    """Address and key of a server."""

    url: str
    key: str = field(repr=False)

    @contextmanager
    def client(self) -> Iterator[SyncPrefectClient]:
        """Yield a Prefect client; RunError if the server refuses or does not answer."""
        settings = {"timeout": _WAIT}
        try:
            with SyncPrefectClient(
                self.url, auth_string=self.key, httpx_settings=settings
            ) as client:
                yield client
        except httpx.HTTPStatusError as error:
            place, code = error.request.url.path, error.response.status_code
            reason = " ".join(error.response.text.split())[:300]
            raise RunError(f"The server refused {place} ({code}): {reason}") from error
        except (httpx.HTTPError, PrefectException, OSError, RuntimeError) as error:
            raise RunError(f"The server at {self.url} does not answer: {error}") from error


def is_server_up(url: str) -> bool:
    """Return whether a Prefect server answers at the address of its API."""
    try:
        return httpx.get(f"{url}/health", timeout=10.0, trust_env=False).is_success
    except httpx.HTTPError:
        return False


def create_work_pool(client: SyncPrefectClient, max_runs: int, paused: bool = False) -> None:
    """Create the work pool, and set its limit of concurrent flows and its pause."""
    with suppress(ObjectAlreadyExists):
        client.create_work_pool(WorkPoolCreate(name=POOL, type="process"))
    update = WorkPoolUpdate(is_paused=paused, concurrency_limit=max_runs)
    client.update_work_pool(POOL, update)


def is_worker_online(client: SyncPrefectClient) -> bool:
    """Return whether a worker is online."""
    try:
        workers = client.read_workers_for_work_pool(POOL)
    except ObjectNotFound:
        return False
    return any(worker.status == "ONLINE" for worker in workers)


def _list_deployments(client: SyncPrefectClient) -> list[dict]:
    """Return all deployments by "flow/name", with the time of the next run."""
    flows = {flow.id: flow.name for flow in client.read_flows()}
    due: dict = {}
    for run in client.read_flow_runs(
        flow_run_filter=FlowRunFilter(state={"type": {"any_": ["SCHEDULED"]}}),
        sort=FlowRunSort.EXPECTED_START_TIME_ASC,
        limit=_AT_ONCE,
    ):
        due.setdefault(run.deployment_id, _iso(run.expected_start_time))
    rows = [
        {
            "name": f"{flows.get(each.flow_id, '?')}/{each.name}",
            "paused": each.paused,
            "schedules": sum(schedule.active for schedule in each.schedules),
            "due": due.get(each.id),
        }
        for each in client.read_deployments()
    ]
    return sorted(rows, key=lambda row: row["name"])


def _list_last_runs(client: SyncPrefectClient) -> list[dict]:
    """Return the latest flow runs that have begun, latest first.

    Runs of the flow that looks into the inboxes are left out: there are too many.
    """
    names = {flow.name for flow in client.read_flows()}
    runs = client.read_flow_runs(
        flow_filter=FlowFilter(name={"any_": sorted(names - {INBOX})}),
        flow_run_filter=FlowRunFilter(state={"type": {"not_any_": ["SCHEDULED", "CANCELLED"]}}),
        sort=FlowRunSort.START_TIME_DESC,
        limit=_LISTED,
    )
    return [
        {
            "id": str(run.id),
            "name": run.name,
            "start_time": _iso(run.start_time),
            "end_time": _iso(run.end_time),
            "total_run_time": run.total_run_time.total_seconds(),
            "state": run.state_name,
            "message": run.state.message if run.state else None,
        }
        for run in runs
    ]


def _iso(time: datetime | None) -> str | None:
    return time.astimezone(UTC).isoformat() if time else None


def read_status(home: Path) -> Mapping:
    """Return the status of a store as its JSON document; waits for a busy server.

    It is healthy where the next scheduled run will start. Times are UTC in ISO 8601.
    """
    running = read_running(home)
    status = {
        "schema": 1,
        "healthy": False,
        "stopped": running is None or running.stopped,
        "wrong": [],
        "ui": running and running.ui,
        "pages": {},
        "api": running and running.url,
        "database": running and running.database,
        "server": False,
        "worker": "gone",
        "workers": running.workers if running else 0,
        "deployments": [],
        "runs": [],
        "refused": [],
    }
    if running is None or running.stopped:
        return status
    ended = [name for name in PROCESSES if not is_process_running(home, name)]
    wrong = [f"the {name} has ended; see {home}/{name}.log" for name in ended]
    status |= {"wrong": wrong, "worker": "gone" if "worker" in ended else "starting"}
    if "server" in ended:
        return status
    try:
        with Api(running.url, read_access_key(home)).client() as client:
            if is_worker_online(client):
                status["worker"] = "online"
            elif "worker" not in ended:
                wrong.append("the worker has not reported yet")
            status["deployments"] = _list_deployments(client)
            status["runs"] = _list_last_runs(client)
    except RunError as error:
        wrong.append(str(error))
        return status
    if not status["deployments"]:
        wrong.append("it has no deployments")
    lately = datetime.now(UTC).replace(tzinfo=None) - _LATELY
    refused = [
        {"robot": row["robot"], "why": row["why"], "at": row["created"].isoformat()}
        for row in list_refused_logs(home.parent, lately)
    ]
    pages = {"reports": f"{running.pages}/{INDEX}"}
    more = {"healthy": not wrong, "pages": pages, "server": True, "refused": refused}
    return status | more


def wait_until(ready: Callable[[], bool], seconds: float, otherwise: str) -> None:
    """Wait until a condition holds; else RunError with the text `otherwise`."""
    begun = monotonic()
    while not ready():
        if monotonic() - begun > seconds:
            raise RunError(otherwise)
        sleep(0.25)
