"""The request, processes, state file, environments and key of the service of a store.

Server and worker outlive the command that starts them. Each holds a lock on its pid
file, which shows that it runs even if another process has its pid.
"""

import fcntl
import os
import secrets
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from pathlib import Path
from tempfile import mkstemp
from time import monotonic, sleep
from typing import Annotated, Any
from urllib.parse import urlsplit

from cyclopts import Parameter
from pydantic import TypeAdapter

from flows.outputs import json_text, write_files
from flows.requests import Count, Flag, Request, Store
from flows.settings import API, ONE_THREAD, PAGES, ROOT, STORE, build_prefect_environment
from flows.workers import lock_file
from residual.errors import InputError, RunError, build_missing_package_error
from warehouse.bucket import is_loopback_host

KEY = "key"  # in Prefect's folder of the store
# Environment variables of the key, for clients and server of Prefect.
CLIENT, SERVER = "PREFECT_API_AUTH_STRING", "PREFECT_SERVER_API_AUTH_STRING"
PROCESSES = ("server", "worker")
_SHORTEST = 32
_FILE, _LOCK = "up.json", "up.lock"
_GRACE = 15.0  # s between SIGTERM and SIGKILL


def start_process(home: Path, name: str, command: Sequence[str], env: Mapping[str, str]) -> None:
    """Start a process in its own session, its output in a log file; RunError if it runs."""
    with (home / f"{name}.pid").open("a+") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise RunError(f"The {name} of {home.parent} is already running.") from None
        with (home / f"{name}.log").open("ab") as output:
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                env=dict(env),
                cwd=home,
                start_new_session=True,
                umask=0o077,
                pass_fds=[lock.fileno()],  # the process keeps the lock
            )
        lock.truncate(0)
        lock.write(str(process.pid))


def is_process_running(home: Path, name: str) -> bool:
    """Return whether the process of a name runs."""
    try:
        with (home / f"{name}.pid").open() as lock:
            fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except FileNotFoundError:
        return False
    except BlockingIOError:
        return True
    return False


def stop_process(home: Path, name: str, grace: float = _GRACE) -> None:
    """End a process by SIGTERM, and after `grace` seconds by SIGKILL."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        if is_process_running(home, name):
            with suppress(OSError, ValueError):
                os.kill(int((home / f"{name}.pid").read_text()), number)
        until = monotonic() + grace
        while is_process_running(home, name) and monotonic() < until:
            sleep(0.1)


@dataclass(frozen=True, slots=True)
class RunningService:
    """The service that was started for a store."""

    host: str  # address that the server listens on
    port: int
    database: str  # where the history is, without a password
    deployed: str = ""  # hash of the deployments
    workers: int = 1  # flows that run at once
    stopped: bool = False  # by modelgap down

    @property
    def ui(self) -> str:
        """Address for people."""
        # A server on all addresses also listens on loopback.
        name = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(self.host, self.host)
        return f"http://{f'[{name}]' if ':' in name else name}:{self.port}"

    @property
    def url(self) -> str:
        """Address of the API."""
        return f"{self.ui}/api"

    @property
    def pages(self) -> str:
        """Address of the pages over the store."""
        return f"{self.ui}/pages"


def read_running(home: Path) -> RunningService | None:
    """Return the last service of a store, running or not."""
    try:
        return TypeAdapter(RunningService).validate_json((home / _FILE).read_bytes())
    except (OSError, ValueError):
        return None  # a file of another version


def write_running(home: Path, running: RunningService) -> None:
    """Write the state file."""
    write_files({home / _FILE: json_text(asdict(running))})


@contextmanager
def lock_service(home: Path) -> Iterator[None]:
    """Lock out a second `up` or `down` of the same store."""
    with lock_file(home / _LOCK) as ours:
        if not ours:
            raise RunError(f"Another modelgap up or down is running on {home.parent}. Wait for it.")
        yield


def read_access_key(home: Path) -> str:
    """Return the key of a store, created if there is none.

    Raises:
        InputError: If others can read the file, or it holds no key.
    """
    path = home / KEY
    if not path.exists():
        handle, draft = mkstemp(dir=path.parent, prefix=f"{path.name}.")  # 0600
        try:
            with os.fdopen(handle, "w", encoding="ascii") as file:
                file.write(f"modelgap:{secrets.token_urlsafe(32)}\n")
                file.flush()
                os.fsync(file.fileno())
            with suppress(FileExistsError):
                os.link(draft, path)
        finally:
            os.unlink(draft)
    if path.stat().st_mode & 0o077:
        raise InputError(
            f"{path} can be read by others, expected by its owner only. Delete it, "
            "then modelgap down and modelgap up create a new key."
        )
    key = path.read_text(encoding="ascii", errors="replace").strip()
    if len(key) < _SHORTEST or not key.isprintable():
        raise InputError(
            f"{path} is no key. Delete it, then modelgap down and modelgap up create a new key."
        )
    return key


DATABASE = "MODELGAP_DATABASE_URL"
PORT = 4200
_DRIVER = "postgresql+asyncpg"
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
    # Any: what reads a project takes longer to load than a typing error may take.
    project: Annotated[Any, Parameter(parse=False)] = None


def check_request(request: ServiceRequest) -> None:
    """Raise InputError for values out of range, and for an open network."""
    for name, most in (("port", 65535), ("workers", 64)):
        value = getattr(request, name)
        if value is not None and not 1 <= value <= most:
            raise InputError(f"--{name} {value}: expected 1 to {most}.")
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
        raise build_missing_package_error("prefect")


def check_host(host: str, trust_network: bool) -> None:
    """Raise InputError for an address on the network without --trust-network."""
    if not is_loopback_host(host) and not trust_network:
        raise InputError(
            f"--host {host} opens the server to the network, without encryption: an "
            "eavesdropper learns the key and can run programs as you. If you trust the "
            "network: --trust-network."
        )


def database_url(url: str) -> str:
    """Return the address of a PostgreSQL database for Prefect; else InputError."""
    try:
        parts = urlsplit(url)
        schemes = ("postgresql", "postgres", _DRIVER)
        usable = parts.scheme in schemes and bool(parts.path.strip("/"))
    except ValueError:
        usable = False
    if not usable:
        raise InputError(
            f"${DATABASE} is not usable, expected postgresql://USER:PASSWORD@HOST:PORT/NAME."
        )
    return _DRIVER + url[url.index("://") :]


def format_database_label(url: str | None) -> str:
    """Return the address of the history without user and password."""
    if url is None:
        return "sqlite"
    parts = urlsplit(url)
    place = parts.netloc.rpartition("@")[2] or "localhost"
    return f"postgresql://{place}{parts.path}"


def build_server_environment(running: RunningService, home: Path, database: str | None) -> dict:
    """Return the environment of the server, with the key."""
    settings = {
        STORE: str(home.parent),
        "PREFECT_SERVER_API_HOST": running.host,
        "PREFECT_SERVER_API_PORT": str(running.port),
        SERVER: read_access_key(home),
        # Relative to the page, so that any name of this server works.
        "PREFECT_SERVER_UI_API_URL": "/api",
        "PREFECT_SERVER_UI_SHOW_PROMOTIONAL_CONTENT": "false",
        # No page of another origin may read an answer; `Guard` checks requests.
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


def build_worker_environment(running: RunningService, store: Path, home: Path) -> dict:
    """Return the environment of the worker and its flows: with the key, no password."""
    # This Python first: the shell may have another one.
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    return (
        _base(home)
        | ONE_THREAD
        | {
            API: running.url,
            CLIENT: read_access_key(home),
            STORE: str(store),
            PAGES: running.pages,
            "PATH": path,
            "PREFECT_FLOWS_HEARTBEAT_FREQUENCY": str(BEAT),
        }
    )


def _base(home: Path) -> dict[str, str]:
    """Return our environment without the settings of another Prefect."""
    kept = {k: v for k, v in os.environ.items() if not k.startswith("PREFECT") and k != DATABASE}
    level = {"PREFECT_LOGGING_HANDLERS_CONSOLE_LEVEL": "WARNING"}
    # Python finds our code from any working directory.
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    return kept | build_prefect_environment(home) | level | {"PYTHONPATH": path}
