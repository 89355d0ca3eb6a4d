"""The processes of the service of a store, their state file, and the key of the store.

Server and worker outlive the command that starts them. Each holds a lock on its pid
file, which shows that it runs even if another process has its pid.
"""

import fcntl
import os
import secrets
import signal
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import mkstemp
from time import monotonic, sleep

from pydantic import TypeAdapter

from flows.outputs import json_text, write_all
from residual.errors import InputError, RunError

KEY = "key"  # in Prefect's folder of the store
# Environment variables of the key, for clients and server of Prefect.
CLIENT, SERVER = "PREFECT_API_AUTH_STRING", "PREFECT_SERVER_API_AUTH_STRING"
PROCESSES = ("server", "worker")
_SHORTEST = 32
_FILE, _LOCK = "up.json", "up.lock"
_GRACE = 15.0  # s between SIGTERM and SIGKILL


def start(
    home: Path, name: str, command: Sequence[str], env: Mapping[str, str]
) -> None:
    """Start a process in its own session, with its output in a log file.

    Raises:
        RunError: If one of that name runs.
    """
    with (home / f"{name}.pid").open("a+") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise RunError(f"The {name} of {home.parent} runs already.") from None
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


def lives(home: Path, name: str) -> bool:
    """Return whether the process of a name runs."""
    try:
        with (home / f"{name}.pid").open() as lock:
            fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except FileNotFoundError:
        return False
    except BlockingIOError:
        return True
    return False


def stop(home: Path, name: str, grace: float = _GRACE) -> None:
    """End a process by SIGTERM, and after `grace` seconds by SIGKILL."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        if lives(home, name):
            with suppress(OSError, ValueError):
                os.kill(int((home / f"{name}.pid").read_text()), number)
        until = monotonic() + grace
        while lives(home, name) and monotonic() < until:
            sleep(0.1)


@dataclass(frozen=True, slots=True)
class Running:
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


def read_running(home: Path) -> Running | None:
    """Return the last service of a store, running or not."""
    try:
        return TypeAdapter(Running).validate_json((home / _FILE).read_bytes())
    except (OSError, ValueError):
        return None  # a file of another version


def write_running(home: Path, running: Running) -> None:
    """Write the state file."""
    write_all({home / _FILE: json_text(asdict(running))})


@contextmanager
def one_at_a_time(home: Path) -> Iterator[None]:
    """Lock out a second `up` or `down` of the same store."""
    with (home / _LOCK).open("a") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise RunError(
                f"Another modelgap up or down is running on {home.parent}. Wait for it."
            ) from None
        yield


def store_key(home: Path) -> str:
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
            f"{path} is no key. Delete it, then modelgap down and modelgap up create a "
            "new key."
        )
    return key
