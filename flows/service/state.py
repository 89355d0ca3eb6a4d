"""What runs for a store, written down in the store, and the key that opens it.

Its processes outlive the command that started them, and are found again.
"""

import fcntl
import os
import secrets
import signal
import socket
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
_SHORTEST = 32
_FILE, _LOCK = "up.json", "up.lock"
_PROC = Path("/proc")
_GRACE = 15.0  # s between the request to end and the end


@dataclass(frozen=True, slots=True)
class Process:
    """A process that was started."""

    name: str  # what it does, such as "server"
    pid: int  # its number, which the system gives to others after it has ended
    started: str  # when it was started, as the system counts; with it no other is meant

    @property
    def lives(self) -> bool:
        """Whether it runs: this very process, not a later one of the same number."""
        return started_at(self.pid) == self.started


def start(
    name: str,
    command: Sequence[str],
    env: Mapping[str, str],
    log: Path,
    umask: int = -1,
) -> Process:
    """Start a process in a session of its own.

    Args:
        log: Where it writes what it has to say, after what is there.
        umask: Rights that its files do not get; -1 for those of ours.
    """
    with log.open("ab") as output:
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=output,
            env=dict(env),
            cwd=log.parent,
            start_new_session=True,
            umask=umask,
        )
    return Process(name, process.pid, started_at(process.pid) or "ended")


def stop(processes: Sequence[Process], grace: float = _GRACE) -> None:
    """Ask processes to end; those that do not are killed.

    Args:
        processes: Which; that they have ended already is no error.
        grace: Time that they get [s].
    """
    for process in processes:
        _signal(process, signal.SIGTERM)
    until = monotonic() + grace
    while any(p.lives for p in processes) and monotonic() < until:
        sleep(0.1)
    for process in processes:
        _signal(process, signal.SIGKILL)
    while any(p.lives for p in processes) and monotonic() < until + grace:
        sleep(0.05)


def started_at(pid: int) -> str | None:
    """Return when a process was started, None if there is none or it has ended."""
    try:
        text = (_PROC / str(pid) / "stat").read_text()
        boot = (_PROC / "sys/kernel/random/boot_id").read_text().strip()
    except OSError:
        return None
    # The name, in brackets, may have spaces and brackets itself; state is first after.
    fields = text.rpartition(")")[2].split()
    return None if fields[0] in "ZX" else f"{boot[:8]}-{fields[19]}"


def flow_processes() -> dict[str, list[Process]]:
    """Return our processes that run a flow for a worker, by the id of the flow run."""
    found: dict[str, list[Process]] = {}
    for pid, env in _environments():
        id = env.get("PREFECT__FLOW_RUN_ID")
        started = started_at(pid)
        if id and started:
            found.setdefault(id, []).append(Process("flow run", pid, started))
    return found


def _environments() -> Iterator[tuple[int, dict[str, str]]]:
    for folder in _PROC.iterdir():
        if not folder.name.isdigit():
            continue
        try:
            raw = (folder / "environ").read_bytes()
        except OSError:  # ended meanwhile, or of somebody else
            continue
        words = raw.decode(errors="replace").split("\0")
        yield int(folder.name), dict(w.split("=", 1) for w in words if "=" in w)


def _signal(process: Process, number: int) -> None:
    if not process.lives:
        return
    with suppress(ProcessLookupError):
        os.kill(process.pid, number)


def worker_name(name: str) -> str:
    """Return the name under which a worker of this machine reports."""
    return f"{name}@{socket.gethostname()}"


@dataclass(frozen=True, slots=True)
class Running:
    """A server and its workers."""

    host: str  # address that the server listens on
    port: int
    database: str  # where the history is, without a password
    deployed: str = ""  # hash of the prefect.yaml and its options that were put on it
    processes: tuple[Process, ...] = ()  # the server, then the workers

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

    @property
    def server(self) -> Process | None:
        """The server, if it lives."""
        return next((p for p in self.alive if p.name == "server"), None)

    @property
    def workers(self) -> tuple[Process, ...]:
        """The workers that live."""
        return tuple(p for p in self.alive if p.name != "server")

    @property
    def alive(self) -> tuple[Process, ...]:
        """All processes that live."""
        return tuple(p for p in self.processes if p.lives)


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
