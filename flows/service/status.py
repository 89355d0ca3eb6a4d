"""What runs for a store, whether it is well, and a diagnosis given to it."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from flows.report.night import questions
from flows.report.night.look import ask
from flows.requests import Diagnose
from flows.service import api
from flows.service.api import answers
from flows.service.state import Running, read_running, store_key, worker_name
from flows.settings import PREFECT
from residual.errors import RunError
from warehouse.query.store import open_store

_LATELY = timedelta(days=1)
_DEPLOYMENT = "diagnose/diagnose"


@dataclass(frozen=True, slots=True)
class Status:
    """State of the service of one store."""

    running: Running | None  # what was started, None if nothing was
    server: bool = False  # whether the server answers
    # Each worker by name: "online", "starting" or "gone".
    workers: Mapping[str, str] | None = None
    # Each with when it is due (`api.deployments`).
    deployments: tuple[Mapping, ...] = ()
    runs: tuple[Mapping, ...] = ()  # the last flow runs (`api.last_runs`)
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
    to = api.Api(running.url, store_key(home))
    try:
        online = api.workers_online(to)
        deployments = tuple(api.deployments(to))
        runs = tuple(api.last_runs(to, most))
    except RunError:
        return Status(running, workers=gone)
    workers = {
        p.name: "online" if p.lives and worker_name(p.name) in online else gone[p.name]
        for p in processes
    }
    return Status(running, True, workers, deployments, runs, _refused(home.parent))


def _refused(store: Path) -> tuple[Mapping, ...]:
    since = datetime.now(UTC).replace(tzinfo=None) - _LATELY
    with open_store(store) as opened:
        rows = ask(opened, questions.REFUSED)
    return tuple(row for row in rows if row["created"] and row["created"] > since)


def start_diagnosis(request: Diagnose, store: Path) -> str | None:
    """Let the service of a store make a diagnosis of runs.

    Returns:
        The name of the flow run; None where nobody would run it, so that it is left to
        the caller.
    """
    home = store / PREFECT
    running = read_running(home)
    if running is None or running.server is None or not answers(running.url):
        return None
    to = api.Api(running.url, store_key(home))
    if not api.workers_online(to):
        return None
    parameters = {
        "runs": list(request.logs),
        "good": list(request.baseline),
        "model": request.model,
        "store": str(store),
    }
    return api.start_flow(to, _DEPLOYMENT, parameters)
