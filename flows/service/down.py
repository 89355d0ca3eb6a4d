"""Stop what runs for a store, or stay beside it until then, and lose nothing of it."""

import signal
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from threading import Event
from time import monotonic, sleep

from flows.errors import RunError
from flows.service import api
from flows.service.api import answers
from flows.service.state import (
    Process,
    Running,
    flow_processes,
    one_at_a_time,
    read_running,
    stop,
    store_key,
    write_running,
)
from flows.settings import prefect_home

ENDED = "Ended by modelgap down. What it had stored is kept; the next run goes on."
Say = Callable[[str], None]
_WAIT = 60.0  # s that flow runs may go on after the request to stop


def down(home: Path, wait: float, say: Say) -> Running | None:
    """Let flow runs end, then stop workers and server; schedules and history stay.

    Args:
        wait: How long flow runs may go on [s]; then they are ended and marked.
        say: Told each step, for people.

    Returns:
        What ran, None if nothing did.
    """
    with one_at_a_time(home):
        running = read_running(home)
        if running is None or not running.alive:
            return None
        if answers(running.url) and running.server:
            to = api.Api(running.url, store_key(home))
            _finish_runs(running, to, wait, say)
        stop(running.workers)
        if running.server:
            stop([running.server])
        # Port and database are those of the next start; not who may reach it.
        write_running(home, replace(running, host="127.0.0.1", processes=()))
        return running


def _finish_runs(running: Running, to: api.Api, wait: float, say: Say) -> None:
    """Give out no new work, wait for what runs, end and mark what is left."""
    api.open_pool(to, paused=True)
    until, told = monotonic() + wait, False
    while (active := _active(to)) and monotonic() < until:
        if not told:
            say(f"waiting up to {wait:g} s for {len(active)} flow run(s) to end")
            told = True
        sleep(0.5)
    # Workers first, or they would report the end of their flows in words of their own.
    stop(running.workers)
    left = [p for processes in active.values() for p in processes]
    stop(left)
    for run in api.active_runs(to):
        if run["id"] in active:
            api.end_run(to, run["id"], ENDED)
            say(f"ended: {run['name']}")


def _active(to: api.Api) -> dict[str, list[Process]]:
    """Return the processes on this machine of flow runs of our pool, by id."""
    try:
        ids = {run["id"] for run in api.active_runs(to)}
    except RunError:
        return {}
    return {id: ps for id, ps in flow_processes().items() if id in ids}


def stay(store: Path, say: Say) -> None:
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
