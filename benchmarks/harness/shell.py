"""Commands of the program as a user gives them: what they say, and what they cost."""

import multiprocessing
import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from time import monotonic, perf_counter, sleep

from benchmarks.harness.origin import ROOT

_EVERY = 0.2  # s between two looks at the memory
# The same as the console script, also where that is not installed.
_START = "import sys; from flows.cli import main; sys.exit(main())"


def forked(module: str) -> multiprocessing.context.ForkServerContext:
    """Return what starts processes, each forked from one that has loaded a module.

    Each would load the libraries anew, some seconds for commits of a twentieth of one.
    """
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([module])
    return context


def command(*words: str) -> list[str]:
    return [sys.executable, "-c", _START, *words]


def environment() -> dict[str, str]:
    """Return ours without a store or a server of somebody else."""
    foreign = ("MODELGAP", "PREFECT")
    env = {k: v for k, v in os.environ.items() if not k.startswith(foreign)}
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    return env | {"PYTHONPATH": path}


def modelgap(*words: str, folder: Path = ROOT) -> subprocess.CompletedProcess:
    """Give a command in a folder and wait for it."""
    return subprocess.run(
        command(*words),
        cwd=folder,
        env=environment(),
        capture_output=True,
        text=True,
        check=False,
    )


@dataclass(frozen=True, slots=True)
class Ran:
    """A command that has ended."""

    code: int  # its exit code
    said: str  # what it printed
    seconds: float  # on the clock [s]
    cpu: float  # of the processors [s]
    gigabytes: float  # peak resident memory

    @property
    def failure(self) -> str:
        """Why there is no figure of it."""
        return f"the command failed: {self.said.strip()[-300:]}"


def run_shell(words: list[str], folder: str, tree: bool = False) -> Ran:
    """Run a command of modelgap in a folder and measure it.

    As a tree its memory is that of all its processes together, looked at every fifth of
    a second, in place of the largest one's.
    """
    with tempfile.TemporaryFile("w+") as said:
        start, peak = perf_counter(), 0.0
        process = subprocess.Popen(
            command(*words), cwd=folder, env=environment(), stdout=said, stderr=said
        )
        while tree and not _has_ended(process.pid):
            peak = max(peak, sum(map(_kilobytes, _descendants(process.pid))))
            sleep(_EVERY)
        _, status, usage = os.wait4(process.pid, 0)
        seconds = perf_counter() - start
        process.returncode = os.waitstatus_to_exitcode(status)
        said.seek(0)
        cpu = usage.ru_utime + usage.ru_stime
        # Linux counts in kilobytes.
        gigabytes = (peak if tree else usage.ru_maxrss) / 1e6
        return Ran(process.returncode, said.read(), seconds, cpu, gigabytes)


def _has_ended(pid: int) -> bool:
    """Whether a child waits to be waited for."""
    return os.waitid(os.P_PID, pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None


def _descendants(root: int) -> list[int]:
    """Return a process and all that descend from it."""
    children: dict[int, list[int]] = {}
    for entry in Path("/proc").glob("[0-9]*/stat"):
        try:
            # The name, in parentheses, may hold blanks; what follows does not.
            parent = int(entry.read_text().rpartition(")")[2].split()[1])
        except (OSError, IndexError):
            continue
        children.setdefault(parent, []).append(int(entry.parent.name))
    found, todo = [], [root]
    while todo:
        found.append(todo.pop())
        todo += children.get(found[-1], [])
    return found


def _kilobytes(process: int) -> int:
    """Return resident memory; pages that several processes share count in parts."""
    try:
        lines = Path(f"/proc/{process}/smaps_rollup").read_text().splitlines()
    except OSError:
        return 0
    return next((int(line.split()[1]) for line in lines if line[:4] == "Pss:"), 0)


def processes_of(store: Path) -> list[int]:
    """Return the processes of a store's service: server, worker and flows."""
    word, found = f"MODELGAP_STORE={store}".encode(), []
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            with suppress(OSError):
                if word in (folder / "environ").read_bytes().split(b"\0"):
                    found.append(int(folder.name))
    return found


def free_port() -> str:
    """Return a port of this machine that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return str(probe.getsockname()[1])


def wait_for(done: Callable[[], bool], seconds: float, pause: float = 0.5) -> bool:
    """Wait until something is so, for a time; returns whether it is."""
    until = monotonic() + seconds
    while not done():
        if monotonic() > until:
            return False
        sleep(pause)
    return True
