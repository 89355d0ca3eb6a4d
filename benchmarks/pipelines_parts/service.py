"""From `up` to a schedule that has fired, and what a flow costs a campaign."""

import json
import os
import socket
import subprocess
import sys
from pathlib import Path
from time import monotonic, sleep
from typing import Any

from benchmarks.figures import ROOT, Figures, figure, missing

_PATIENCE = 170.0  # s


def service_figures(folder: Path, quick: bool) -> Figures:
    """Start a service as a user does, wait for its schedule, then time a campaign."""
    from flows.service.api import Api
    from flows.service.state import flow_processes, read_running, stop, store_key

    store = folder / "store"
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = str(probe.getsockname()[1])
    begun = monotonic()
    try:
        # Of the three commands the first is the installation, which is not timed.
        _modelgap("up", "--every", "10", "--port", port, "--store", str(store))
        up = monotonic() - begun
        running = read_running(store / "_prefect")
        api = Api(running.url, store_key(store / "_prefect"))
        fired = None if quick else _fired(api, begun)
        # What the schedule has started must not disturb what follows.
        stop(running.workers)
        stop([p for ps in flow_processes().values() for p in ps if _ours(p, store)])
        slower = _overhead(api, folder, 8 if quick else 100)
    finally:
        _modelgap("down", "--wait", "0", "--store", str(store))
    if quick:
        why = f"{slower['n']} experiments instead of 100"
        slower = {**slower, "ok": None, "why": why}
    return {"prefect_overhead": slower, **_schedule(quick, fired, up)}


def _schedule(quick: bool, fired: float | None, up: float) -> Figures:
    what = "install; modelgap up --every 10; modelgap status"
    commands = figure(3, 3, 1, what=what)
    if quick:
        seconds = missing(180.0, "does not fit into a quick run")
    elif fired is None:
        seconds = figure(_PATIENCE, 180.0, 1, ok=False, why="no flow run in that time")
    else:
        seconds = figure(round(fired, 1), 180.0, 1, up_seconds=round(up, 1))
    return {"schedule_fired_seconds": seconds, "schedule_fired_commands": commands}


def _overhead(api: Any, folder: Path, count: int) -> dict:
    """Time a campaign bare and as a flow, in a process that has the server's address.

    It sends the rest of its logs at its end, for which the server must still be there.
    """
    command = [sys.executable, "-m", "benchmarks.pipelines_parts.overhead"]
    to = {"PREFECT_API_URL": api.url, "PREFECT_API_AUTH_STRING": api.key}
    env = {**os.environ, "PYTHONPATH": str(ROOT), **to}
    words = [*command, str(folder), str(count)]
    done = subprocess.run(
        words, env=env, cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True
    )
    told = json.loads(done.stdout.splitlines()[-1])
    share = told["flow"] / told["bare"] - 1
    return figure(
        round(share, 4),
        0.05,
        count,
        bare_seconds=round(told["bare"], 2),
        flow_seconds=round(told["flow"], 2),
        what="(flow - bare) / bare, wall time; experiments sleep 1 s",
    )


def _modelgap(*words: str) -> None:
    bare = {k: v for k, v in os.environ.items() if not k.startswith("PREFECT")}
    code = "import sys; from flows.cli import main; sys.exit(main())"
    env = {**bare, "PYTHONPATH": str(ROOT)}
    subprocess.run([sys.executable, "-c", code, *words], env=env, check=True)


def _fired(to: Any, begun: float) -> float | None:
    """Return the time until a flow run of the schedule runs [s], None for never."""
    from flows.service import api

    while monotonic() - begun < _PATIENCE:
        if any(run["start_time"] for run in api.last_runs(to)):
            return monotonic() - begun
        sleep(0.2)
    return None


def _ours(process: Any, store: Path) -> bool:
    try:
        raw = Path(f"/proc/{process.pid}/environ").read_bytes()
    except OSError:
        return False
    return f"MODELGAP_STORE={store}".encode() in raw.split(b"\0")
