"""Stay beside a service until it is told to stop, or has stopped by itself."""

import signal
from collections.abc import Callable
from pathlib import Path
from threading import Event

from flows.errors import RunError
from flows.service.down import down
from flows.service.state import read_running
from flows.settings import prefect_home

_WAIT = 60.0  # s that flow runs may go on after the request to stop


def stay(store: Path, say: Callable[[str], None]) -> None:
    """Return after Ctrl-C or SIGTERM, with everything stopped.

    Args:
        say: Told each step.

    Raises:
        RunError: If server or worker have ended; who manages us starts us again.
    """
    home, asked = prefect_home(store), Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: asked.set())
    while not asked.wait(1.0):
        running = read_running(home)
        if running is None or not running.processes:  # modelgap down, from elsewhere
            return
        if len(running.alive) < len(running.processes):
            down(home, 0.0, say)
            raise RunError(f"Server or worker ended; see the logs in {home}.")
    down(home, _WAIT, say)
