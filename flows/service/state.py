"""What runs for a store, written down in the store."""

import fcntl
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

from flows.errors import RunError
from flows.service.processes import Process

_FILE, _LOCK = "up.json", "up.lock"


@dataclass(frozen=True, slots=True)
class Running:
    """A server and its workers.

    Attributes:
        host: Address that the server listens on.
        port: Its port.
        database: Where the history is, without a password.
        deployed: Hash of the prefect.yaml and its options that were put on it.
        processes: The server, then the workers.
        guarded: Whether the server asks for a key; those of earlier versions did not.
    """

    host: str
    port: int
    database: str
    deployed: str = ""
    processes: tuple[Process, ...] = ()
    guarded: bool = False

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
        told = json.loads((home / _FILE).read_text(encoding="utf-8"))
        processes = tuple(Process(**each) for each in told.pop("processes"))
        return Running(**told, processes=processes)
    except (OSError, ValueError, KeyError, TypeError):
        # Half a file there is not, since it is replaced by rename; one of another
        # version is as good as none.
        return None


def write_running(home: Path, running: Running) -> None:
    """Keep what runs; whole or not at all."""
    text = json.dumps(asdict(running), indent=2) + "\n"
    new = home / f"{_FILE}.{os.getpid()}"
    new.write_text(text, encoding="utf-8")
    new.replace(home / _FILE)


@contextmanager
def one_at_a_time(home: Path) -> Iterator[None]:
    """Keep a second `up` or `down` of the same store out; a dead one holds nothing.

    Raises:
        RunError: If another one is at work.
    """
    with (home / _LOCK).open("a") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise RunError(
                f"Another modelgap up or down is at work on {home.parent}. Wait for it."
            ) from None
        yield
