"""The request of `modelgap up`, and the environments of server and worker."""

import os
import sys
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated
from urllib.parse import urlsplit

from cyclopts import Parameter

from flows.project.read import Project
from flows.requests import Count, Flag, Request, Store
from flows.service.state import CLIENT, SERVER, Running, store_key
from flows.settings import (
    API,
    ONE_THREAD,
    PAGES,
    ROOT,
    STORE,
    quiet_prefect,
)
from residual.errors import InputError, not_installed
from warehouse.bucket import is_loopback

DATABASE = "MODELGAP_DATABASE_URL"
PORT = 4200
_DRIVERS = {
    "postgresql": "postgresql+asyncpg",
    "postgres": "postgresql+asyncpg",
    "postgresql+asyncpg": "postgresql+asyncpg",
}
BEAT = 30  # s between heartbeats of a flow run; the smallest that Prefect takes


@dataclass(frozen=True, slots=True)
class ServiceRequest(Request):
    """Start the service; None keeps the value of the last start.

    Attributes:
        port: Port of the server; default 4200.
        host: Address to listen on; any other than this machine needs --trust-network.
        workers: Number of flows that run at once.
        every: Also start the nightly flow every this many seconds; 0 to stop that.
        trust_network: Accept connections from the network. They are not encrypted: an
            eavesdropper learns the key and can run programs as you.
    """

    store: Store = None
    host: Annotated[str | None, Parameter(metavar="ADDRESS")] = None
    port: Count = None
    workers: Count = None
    every: Annotated[int | None, Parameter(metavar="SECONDS")] = None
    trust_network: Flag = False
    # $MODELGAP_DATABASE_URL: others on the machine can read command lines.
    database: Annotated[str | None, Parameter(parse=False)] = None
    project: Annotated[Project | None, Parameter(parse=False)] = None


def check_request(request: ServiceRequest) -> None:
    """Raise InputError for values out of range, and for an open network."""
    if request.port is not None and not 1 <= request.port <= 65535:
        raise InputError(f"--port {request.port}: expected 1 to 65535.")
    if request.workers is not None and not 1 <= request.workers <= 64:
        raise InputError(f"--workers {request.workers}: expected 1 to 64.")
    if request.every is not None and request.every != 0 and request.every < 10:
        raise InputError(f"--every {request.every}: expected 10 seconds or more, or 0.")
    if request.database is not None:
        database_url(request.database)
    check_host(request.host or "127.0.0.1", request.trust_network)
    try:
        scheduler = find_spec("prefect")
    except ModuleNotFoundError:
        scheduler = None
    if scheduler is None:
        raise not_installed("prefect")


def check_host(host: str, trust_network: bool) -> None:
    """Raise InputError for an address on the network without --trust-network."""
    if not is_loopback(host) and not trust_network:
        raise InputError(
            f"--host {host} opens the server to the network, without encryption: an "
            "eavesdropper learns the key and can run programs as you. If you trust the "
            "network: --trust-network."
        )


def database_url(url: str) -> str:
    """Return the address of a PostgreSQL database for Prefect; else InputError."""
    try:
        parts = urlsplit(url)
        usable = parts.scheme in _DRIVERS and bool(parts.path.strip("/"))
    except ValueError:
        usable = False
    if not usable:
        raise InputError(
            f"${DATABASE} is not usable, expected "
            "postgresql://USER:PASSWORD@HOST:PORT/NAME."
        )
    return _DRIVERS[parts.scheme] + url[url.index("://") :]


def database_label(url: str | None) -> str:
    """Return the address of the history without user and password."""
    if url is None:
        return "sqlite"
    parts = urlsplit(url)
    place = parts.netloc.rpartition("@")[2] or "localhost"
    return f"postgresql://{place}{parts.path}"


def server_environment(running: Running, home: Path, database: str | None) -> dict:
    """Return the environment of the server, with the key."""
    settings = {
        STORE: str(home.parent),
        "PREFECT_SERVER_API_HOST": running.host,
        "PREFECT_SERVER_API_PORT": str(running.port),
        SERVER: store_key(home),
        # Relative to the page, so that any name of this server works.
        "PREFECT_SERVER_UI_API_URL": "/api",
        "PREFECT_SERVER_UI_SHOW_PROMOTIONAL_CONTENT": "false",
        # No page of another origin may read an answer; `guard` checks requests.
        "PREFECT_SERVER_CORS_ALLOWED_ORIGINS": running.ui,
        # CSRF tokens protect pages with a cookie; here every request has the key.
        "PREFECT_SERVER_CSRF_PROTECTION_ENABLED": "false",
        # In memory, the leases of running flows would be lost with a killed server.
        "PREFECT_SERVER_CONCURRENCY_LEASE_STORAGE": (
            "prefect.server.concurrency.lease_storage.filesystem"
        ),
        # Wait for a busy SQLite.
        "PREFECT_SERVER_DATABASE_TIMEOUT": "60",
        "PREFECT_API_BLOCKS_REGISTER_ON_START": "false",
        # With the default 60 s, a new schedule starts a minute later.
        "PREFECT_SERVER_SERVICES_SCHEDULER_LOOP_SECONDS": "10",
        "PREFECT__SERVER_FINAL": "1",
    }
    if database:
        settings["PREFECT_SERVER_DATABASE_CONNECTION_URL"] = database_url(database)
    return _base(home) | settings


def worker_environment(running: Running, store: Path, home: Path) -> dict:
    """Return the environment of the worker and its flows: with the key, no password."""
    # This Python first: the shell may have another one.
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    return (
        _base(home)
        | ONE_THREAD
        | {
            API: running.url,
            CLIENT: store_key(home),
            STORE: str(store),
            PAGES: running.pages,
            "PATH": path,
            "PREFECT_FLOWS_HEARTBEAT_FREQUENCY": str(BEAT),
        }
    )


def _base(home: Path) -> dict[str, str]:
    """Return our environment without the settings of another Prefect."""
    kept = {
        k: v
        for k, v in os.environ.items()
        if not k.startswith("PREFECT") and k != DATABASE
    }
    level = {"PREFECT_LOGGING_HANDLERS_CONSOLE_LEVEL": "WARNING"}
    # Python finds our code from any working directory.
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    return kept | quiet_prefect(home) | level | {"PYTHONPATH": path}
