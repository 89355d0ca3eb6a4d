"""Processes that outlive the command that started them, and are found again."""

import os
import signal
import socket
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from time import monotonic, sleep

_PROC = Path("/proc")
_GRACE = 15.0  # s between the request to end and the end


@dataclass(frozen=True, slots=True)
class Process:
    """A process that was started.

    Attributes:
        name: What it does, such as "server".
        pid: Its number, which the system gives to others after it has ended.
        started: When it was started, as the system counts; with it no other is meant.
    """

    name: str
    pid: int
    started: str

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
    with log.open("ab") as said:
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=said,
            stderr=said,
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
