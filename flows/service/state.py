"""What runs for a store, written down in the store, and the key that opens it.

Its two processes outlive the command that started them. Each holds a lock on a file
for as long as it lives, so that it is known whether it does, whatever other process has
got its number since.
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
# Under these names Prefect's clients and its server take it.
CLIENT, SERVER = "PREFECT_API_AUTH_STRING", "PREFECT_SERVER_API_AUTH_STRING"
PROCESSES = ("server", "worker")
_SHORTEST = 32
_FILE, _LOCK = "up.json", "up.lock"
_GRACE = 15.0  # s between the request to end and the end


def start(
    home: Path, name: str, command: Sequence[str], env: Mapping[str, str]
) -> None:
    """Start a process in a session of its own; what it has to say goes into its log.

    Raises:
        RunError: If one of that name lives.
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
                pass_fds=[lock.fileno()],  # the lock is its own from now on
            )
        lock.truncate(0)
        lock.write(str(process.pid))


def lives(home: Path, name: str) -> bool:
    """Return whether a process runs that was started under a name."""
    try:
        with (home / f"{name}.pid").open() as lock:
            fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except FileNotFoundError:
        return False
    except BlockingIOError:
        return True
    return False


def stop(home: Path, name: str, grace: float = _GRACE) -> None:
    """Ask a process to end; one that does not is killed.

    Args:
        name: Which; that it has ended already is no error.
        grace: Time that it gets [s].
    """
    for number in (signal.SIGTERM, signal.SIGKILL):
        if lives(home, name):
            with suppress(OSError, ValueError):
                os.kill(int((home / f"{name}.pid").read_text()), number)
        until = monotonic() + grace
        while lives(home, name) and monotonic() < until:
            sleep(0.1)


@dataclass(frozen=True, slots=True)
class Running:
    """What was started for a store."""

    host: str  # address that the server listens on
    port: int
    database: str  # where the history is, without a password
    deployed: str = ""  # hash of the prefect.yaml and its options that were put on it
    workers: int = 1  # how many flows may run at once
    stopped: bool = False  # whether somebody stopped it

    @property
    def ui(self) -> str:
        """Address for people."""
        # Who listens everywhere is also found here.
        name = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(self.host, self.host)
        return f"http://{f'[{name}]' if ':' in name else name}:{self.port}"

    @property
    def url(self) -> str:
        """Address of the API."""
        return f"{self.ui}/api"

    @property
    def pages(self) -> str:
        """Address below which the pages over the store are."""
        return f"{self.ui}/pages"


def read_running(home: Path) -> Running | None:
    """Return what was started last for a store, whether it lives or not."""
    try:
        return TypeAdapter(Running).validate_json((home / _FILE).read_bytes())
    except (OSError, ValueError):
        # Half a file there is not, since it is replaced by rename; one of another
        # version is as good as none.
        return None


def write_running(home: Path, running: Running) -> None:
    """Keep what runs; whole or not at all."""
    write_all({home / _FILE: json_text(asdict(running))})


@contextmanager
def one_at_a_time(home: Path) -> Iterator[None]:
    """Keep a second `up` or `down` of the same store out; a dead one holds nothing."""
    with (home / _LOCK).open("a") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise RunError(
                f"Another modelgap up or down is at work on {home.parent}. Wait for it."
            ) from None
        yield


def store_key(home: Path) -> str:
    """Return the key of a store's server, made if there is none yet.

    Raises:
        InputError: If others may read it, or it is none.
    """
    path = home / KEY
    if not path.exists():
        _make_key(path)
    if path.stat().st_mode & 0o077:
        raise InputError(
            f"{path} can be read by others, expected by its owner only. Delete it, "
            "then modelgap down and modelgap up: a new one is made."
        )
    key = path.read_text(encoding="ascii", errors="replace").strip()
    if len(key) < _SHORTEST or not key.isprintable():
        raise InputError(
            f"{path} is no key. Delete it, then modelgap down and modelgap up: a new "
            "one is made."
        )
    return key


def _make_key(path: Path) -> None:
    """Write a new key, whole or not at all; of two at once the first one counts."""
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
