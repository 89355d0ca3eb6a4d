"""A Prefect server of our own, for as long as one command runs.

Prefect starts one by itself where none is. That one gets the Ctrl-C that is meant for
us, after which the flow waits for its answers for minutes, and it stays for ever if we
are killed. This one is in a session of its own and ends when its input does.
"""

import atexit
import os
import socket
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from time import monotonic, sleep

from flows.service.api import answers
from flows.service.request import code_path
from flows.service.state import CLIENT, SERVER, store_key
from flows.settings import API

_PATIENCE = 600.0  # s; the first start makes the database, on a busy machine slowly
_GRACE = 10.0  # s
_PROGRAM = "flows.service.serve"
# None of our flows uses blocks, and registering them takes seconds.
_LEAN = {"PREFECT_API_BLOCKS_REGISTER_ON_START": "false", "PREFECT_UI_ENABLED": "false"}


@dataclass(frozen=True, eq=False, slots=True)
class Server:
    """A server that was started.

    Attributes:
        url: Address of its API.
        key: What it wants to see from its clients.
        process: Its process.
        log: Where it writes what it has to say.
    """

    url: str
    key: str = field(repr=False)
    process: subprocess.Popen
    log: Path

    def wait(self) -> None:
        """Return when it answers.

        Raises:
            RuntimeError: If it has ended, or takes too long.
        """
        begun = monotonic()
        while not answers(self.url):
            if self.process.poll() is not None or monotonic() - begun > _PATIENCE:
                raise RuntimeError(f"Prefect's server did not start; see {self.log}.")
            sleep(0.1)

    def use(self) -> None:
        """Let Prefect in this process be a client of it; before Prefect is imported."""
        os.environ.update({API: self.url, CLIENT: self.key})

    def stop(self) -> None:
        """End it."""
        self.process.stdin.close()
        try:
            self.process.wait(_GRACE)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()


def start_server(home: Path) -> Server:
    """Start a server that ends with this process, however that ends.

    To be called before Prefect is imported: what Prefect still has to send at our exit
    it sends before the server is stopped then.
    """
    log, port, key = home / "server.log", _free_port(), store_key(home)
    # -P: the folder that we are called from must not be a place to import from.
    command = [sys.executable, "-P", "-m", _PROGRAM, str(port)]
    with log.open("ab") as said:
        process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=said,
            stderr=said,
            env={**os.environ, **_LEAN, SERVER: key, "PYTHONPATH": code_path()},
            start_new_session=True,
            umask=0o077,
        )
    server = Server(f"http://127.0.0.1:{port}/api", key, process, log)
    atexit.register(server.stop)
    return server


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]
