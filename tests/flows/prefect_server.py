"""The one Prefect server of a test process, and what a file of tests asks it with."""

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
    read_access_key,
    start_process,
    stop_process,
)
from flows.service.up import build_server_command, create_history
from flows.settings import API, build_prefect_environment
from tests.waiting import until

# Ends the server once it has no input any more, as when we are killed.
GUARD = "import os, sys; sys.stdin.read(); os.kill(int(sys.argv[1]), 15)"
PATIENCE = 10.0  # s that messages to a server which was killed are waited for


@dataclass(frozen=True)
class Server:
    """A server, and a process that ends it where this one is killed."""

    home: Path
    url: str
    key: str
    guard: subprocess.Popen

    @property
    def lives(self) -> bool:
        return is_process_running(self.home, "server")

    def end(self) -> None:
        self.guard.kill()
        self.guard.communicate()
        stop_process(self.home, "server")


def started(home: Path) -> Server:
    running = _start(home, PREFECT_UI_ENABLED="false")
    command = [sys.executable, "-IS", "-c", GUARD, (home / "server.pid").read_text()]
    guard = subprocess.Popen(command, stdin=subprocess.PIPE)
    return Server(home, running.url, read_access_key(home), guard)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def _start(home: Path, **more: str) -> RunningService:
    create_history(home)
    running = RunningService("127.0.0.1", free_port(), "sqlite")
    env = build_server_environment(running, home, None) | more
    start_process(home, "server", build_server_command(running), env)
    until(lambda: is_server_up(running.url) or not is_process_running(home, "server"), "it answers")
    assert is_process_running(home, "server"), (home / "server.log").read_text()
    return running


@contextmanager
def served(home: Path, **more: str) -> Iterator[RunningService]:
    """Start the server of `modelgap up` as it starts it, and no worker."""
    try:
        yield _start(home, **more)
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
