"""Commands of the program as a user gives them, and what they started."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from time import monotonic, sleep

from benchmarks.figures import ROOT
from flows.service.state import flow_processes, read_running
from flows.settings import PREFECT

_START = "import sys; from flows.cli import main; sys.exit(main())"


def modelgap(*words: str, folder: Path) -> subprocess.CompletedProcess:
    """Give a command in a folder and wait for it."""
    return subprocess.run(
        command(*words),
        cwd=folder,
        env=environment(),
        capture_output=True,
        text=True,
        check=False,
    )


def command(*words: str) -> list[str]:
    """Return the command line of a command."""
    return [sys.executable, "-c", _START, *words]


def environment() -> dict[str, str]:
    """Return ours without a store of somebody else."""
    env = {k: v for k, v in os.environ.items() if not k.startswith("MODELGAP")}
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    return env | {"PYTHONPATH": path}


def kill_service(store: Path) -> int:
    """Kill server, workers and flows of a store, -9; returns how many processes."""
    running = read_running(store / PREFECT)
    ours = f"{store}"
    killed = list(running.alive) if running else []
    for flows in flow_processes().values():
        killed += [p for p in flows if _store_of(p.pid) == ours]
    for process in killed:
        if process.lives:
            os.kill(process.pid, signal.SIGKILL)
    return len(killed)


def wait_for(done: Callable[[], bool], seconds: float, pause: float = 0.5) -> bool:
    """Wait until something is so, for a time; returns whether it is."""
    until = monotonic() + seconds
    while not done():
        if monotonic() > until:
            return False
        sleep(pause)
    return True


def _store_of(pid: int) -> str | None:
    try:
        words = Path(f"/proc/{pid}/environ").read_bytes().decode().split("\0")
    except OSError:
        return None
    values = (w.partition("=")[2] for w in words if w.startswith("MODELGAP_STORE="))
    return next(values, None)
