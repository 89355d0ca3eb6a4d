"""The one Prefect server of a test process, and what a file of tests asks it with."""

import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

from flows.service.api import is_server_up
from flows.service.state import (
    CLIENT,
    RunningService,
    build_server_environment,
    is_process_running,
    start_process,
    stop_process,
)
from flows.service.up import build_server_command, create_history
from flows.settings import API, build_prefect_environment
from tests.waiting import until

ROOT = Path(__file__).parents[2]
# It ends the server once it has no input any more, as when we are killed.
OWNER = """
import sys
from pathlib import Path
from flows.service.state import read_access_key
from tests.flows.prefect_server import served

home = Path(sys.argv[1])
with served(home, PREFECT_UI_ENABLED="false") as running:
    pid = (home / "server.pid").read_text()
    print(running.url, pid, read_access_key(home), flush=True)
    sys.stdin.read()
"""
PATIENCE = 10.0  # s that messages to a server which was killed are waited for


@dataclass(frozen=True)
class Server:
    """A server that a process of its own has started, so that a test can kill it."""

    home: Path
    url: str
    process: int
    key: str
    owner: subprocess.Popen

    @property
    def lives(self) -> bool:
        return self.owner.poll() is None

    def end(self) -> None:
        self.owner.stdin.close()
        self.owner.wait()


def started(home: Path) -> Server:
    owner = subprocess.Popen(
        [sys.executable, "-c", OWNER, str(home)],
        cwd=ROOT,
        env={
            **{k: v for k, v in os.environ.items() if not k.startswith("PREFECT")},
            "PYTHONPATH": str(ROOT),
        },
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    url, process, key = owner.stdout.readline().split()
    return Server(home, url, int(process), key, owner)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@contextmanager
def served(home: Path, **more: str) -> Iterator[RunningService]:
    """Start the server of `modelgap up` as it starts it, and no worker."""
    create_history(home)
    running = RunningService("127.0.0.1", free_port(), "sqlite")
    env = build_server_environment(running, home, None) | more
    start_process(home, "server", build_server_command(running), env)
    try:
        until(
            lambda: is_server_up(running.url) or not is_process_running(home, "server"),
            "it answers",
        )
        assert is_process_running(home, "server"), (home / "server.log").read_text()
        yield running
    finally:
        stop_process(home, "server")


@contextmanager
def server_settings(server: Server):
    """Let flows of this process ask that server, and none once the context ends."""
    with pytest.MonkeyPatch.context() as patch:
        given = {API: server.url, CLIENT: server.key}
        for name, value in {**build_prefect_environment(server.home), **given}.items():
            patch.setenv(name, value)
        from prefect import settings

        updates = {
            settings.PREFECT_HOME: server.home,
            settings.PREFECT_API_URL: server.url,
            settings.PREFECT_API_AUTH_STRING: server.key,
            settings.PREFECT_LOGGING_TO_API_ENABLED: False,  # they may come too late
            # Without a heartbeat a flow ends when it ends, and not a second later.
            settings.PREFECT_FLOWS_HEARTBEAT_FREQUENCY: None,
        }
        with settings.temporary_settings(updates):
            yield
            # Prefect keeps its clients for the life of a process: flows of a later file
            # would ask a server that may be gone for their slots.
            from prefect._internal.concurrency.services import _QueueServiceBase

            _QueueServiceBase.drain_all(timeout=PATIENCE, at_exit=False)
