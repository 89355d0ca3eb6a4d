"""Queries to the Prefect server of a store, and the status of the service.

To be imported under `flows.settings.build_prefect_environment`.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from time import monotonic, sleep

import httpx
from prefect.client.orchestration import SyncPrefectClient
from prefect.client.schemas.actions import WorkPoolCreate, WorkPoolUpdate
from prefect.client.schemas.filters import (
    FlowFilter,
    FlowRunFilter,
    WorkPoolFilter,
)
from prefect.client.schemas.objects import FlowRun as Run
from prefect.client.schemas.sorting import FlowRunSort
from prefect.exceptions import ObjectAlreadyExists, ObjectNotFound, PrefectException

from flows.report.store_index import INDEX, list_refused_logs
from flows.service.state import (
    PROCESSES,
    RunningService,
    is_process_running,
    read_access_key,
    read_running,
)
from residual.errors import RunError

POOL = "modelgap"
INBOX = "inbox"  # name of the flow of the inboxes
ACTIVE = ("PENDING", "RUNNING", "CANCELLING")
_AT_ONCE = 200  # rows of one answer of the server
_LATELY = timedelta(days=1)
_WAIT = 60.0  # s for an answer


@dataclass(frozen=True, slots=True)
class Api:
    """Address and key of a server."""

    url: str
    key: str = field(repr=False)

    @contextmanager
    def client(self, wait: float = _WAIT) -> Iterator[SyncPrefectClient]:
        """Yield a Prefect client; RunError if the server refuses or does not answer."""
        settings = {"timeout": wait}
        try:
            with SyncPrefectClient(
                self.url, auth_string=self.key, httpx_settings=settings
            ) as client:
                yield client
        except httpx.HTTPStatusError as error:
            place, code = error.request.url.path, error.response.status_code
            reason = " ".join(error.response.text.split())[:300]
            words = f"The server refused {place} ({code}): {reason}"
            raise RunError(words) from error
        except (httpx.HTTPError, PrefectException, OSError, RuntimeError) as error:
            words = f"The server at {self.url} does not answer: {error}"
            raise RunError(words) from error


def is_server_up(url: str, timeout: float = 10.0) -> bool:
    """Return whether a Prefect server answers at the address of its API."""
    try:
        return httpx.get(f"{url}/health", timeout=timeout, trust_env=False).is_success
    except httpx.HTTPError:
        return False


def create_work_pool(
    client: SyncPrefectClient, max_runs: int, paused: bool = False
) -> None:
    """Create the work pool, and set its limit of concurrent flows and its pause."""
    with suppress(ObjectAlreadyExists):
        client.create_work_pool(WorkPoolCreate(name=POOL, type="process"))
    update = WorkPoolUpdate(is_paused=paused, concurrency_limit=max_runs)
    client.update_work_pool(POOL, update)


def list_active_runs(client: SyncPrefectClient) -> list[Run]:
    """Return the active flow runs of our pool."""
    pool = WorkPoolFilter(name={"any_": [POOL]})
    states = FlowRunFilter(state={"type": {"any_": ACTIVE}})
    return client.read_flow_runs(flow_run_filter=states, work_pool_filter=pool)


def is_worker_online(client: SyncPrefectClient) -> bool:
    """Return whether a worker is online."""
    try:
        workers = client.read_workers_for_work_pool(POOL)
    except ObjectNotFound:
        return False
    return any(worker.status == "ONLINE" for worker in workers)


def list_deployments(client: SyncPrefectClient) -> list[Mapping]:
    """Return all deployments by "flow/name", with the time of the next run."""
    flows = {flow.id: flow.name for flow in client.read_flows()}
    due: dict = {}
    for run in client.read_flow_runs(
        flow_run_filter=FlowRunFilter(state={"type": {"any_": ["SCHEDULED"]}}),
        sort=FlowRunSort.EXPECTED_START_TIME_ASC,
        limit=_AT_ONCE,
    ):
        due.setdefault(run.deployment_id, run.expected_start_time)
    rows = [
        {
            "name": f"{flows.get(each.flow_id, '?')}/{each.name}",
            "paused": each.paused,
            "schedules": sum(schedule.active for schedule in each.schedules),
            "due": due.get(each.id),
        }
        for each in client.read_deployments()
    ]
    return sorted(rows, key=lambda d: d["name"])


def delete_other_deployments(
    client: SyncPrefectClient, deployed: Sequence[Mapping]
) -> None:
    """Remove our deployments that are not in the list."""
    ours = {(each["name"], each["entrypoint"]) for each in deployed}
    for each in client.read_deployments():
        if POOL in (each.tags or ()) and (each.name, each.entrypoint) not in ours:
            client.delete_deployment(each.id)


def list_last_runs(client: SyncPrefectClient, most: int = 10) -> list[Mapping]:
    """Return the latest flow runs that have begun, latest first.

    Runs of the flow that looks into the inboxes are left out: there are too many.
    """
    names = {flow.name for flow in client.read_flows()}
    runs = client.read_flow_runs(
        flow_filter=FlowFilter(name={"any_": sorted(names - {INBOX})}),
        flow_run_filter=FlowRunFilter(
            state={"type": {"not_any_": ["SCHEDULED", "CANCELLED"]}}
        ),
        sort=FlowRunSort.START_TIME_DESC,
        limit=most,
    )
    return [
        {
            "id": str(run.id),
            "name": run.name,
            "start_time": run.start_time and run.start_time.isoformat(),
            "end_time": run.end_time and run.end_time.isoformat(),
            "total_run_time": run.total_run_time.total_seconds(),
            "state": run.state_name,
            "message": run.state.message if run.state else None,
        }
        for run in runs
    ]


@dataclass(frozen=True, slots=True)
class Status:
    """State of the service of a store."""

    running: RunningService | None  # None if it was never started
    wrong: tuple[str, ...] = ()  # problems, as text
    server: bool = False  # the server answers
    worker: str = "gone"  # "online", "starting" or "gone"
    deployments: tuple[Mapping, ...] = ()
    runs: tuple[Mapping, ...] = ()  # the last flow runs (`last_runs`)
    refused: tuple[Mapping, ...] = ()  # logs refused within a day, latest first

    @property
    def healthy(self) -> bool:
        """Whether the next scheduled run will start."""
        return self.running is not None and not self.running.stopped and not self.wrong

    @property
    def pages(self) -> Mapping[str, str]:
        """Address of the index of all reports, none if no server answers."""
        if self.running is None or not self.server:
            return {}
        return {"reports": f"{self.running.pages}/{INDEX}"}

    def document(self) -> dict:
        """Return the JSON document; times are UTC in ISO 8601."""
        running = self.running
        return {
            "schema": 1,
            "healthy": self.healthy,
            "stopped": running is None or running.stopped,
            "wrong": list(self.wrong),
            "ui": running.ui if running else None,
            "pages": dict(self.pages),
            "api": running.url if running else None,
            "database": running.database if running else None,
            "server": self.server,
            "worker": self.worker,
            "deployments": [
                {**d, "due": d["due"].isoformat() if d["due"] else None}
                for d in self.deployments
            ],
            "runs": list(self.runs),
            "refused": [
                {"robot": r["robot"], "why": r["why"], "at": r["created"].isoformat()}
                for r in self.refused
            ],
        }


def read_status(home: Path, most: int = 10) -> Status:
    """Return the status of a store; waits for a busy server."""
    running = read_running(home)
    if running is None or running.stopped:
        return Status(running)
    ended = [name for name in PROCESSES if not is_process_running(home, name)]
    wrong = tuple(f"the {name} has ended; see {home}/{name}.log" for name in ended)
    worker = "gone" if "worker" in ended else "starting"
    if "server" in ended:
        return Status(running, wrong, worker=worker)
    try:
        with Api(running.url, read_access_key(home)).client() as client:
            if is_worker_online(client):
                worker = "online"
            elif worker == "starting":
                wrong = (*wrong, "the worker has not reported yet")
            due = tuple(list_deployments(client))
            runs = tuple(list_last_runs(client, most))
    except RunError as error:
        return Status(running, (*wrong, str(error)), worker=worker)
    if not due:
        wrong = (*wrong, "it has no deployments")
    lately = datetime.now(UTC).replace(tzinfo=None) - _LATELY
    turned_away = tuple(list_refused_logs(home.parent, lately))
    return Status(running, wrong, True, worker, due, runs, turned_away)


def wait_until(ready: Callable[[], bool], seconds: float, otherwise: str) -> None:
    """Wait until a condition holds; else RunError with the text `otherwise`."""
    begun = monotonic()
    while not ready():
        if monotonic() - begun > seconds:
            raise RunError(otherwise)
        sleep(0.25)
