"""What schedules and flows cost, two processes against one, and a Dask cluster."""

import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import monotonic, perf_counter, sleep

from distributed import Client

from benchmarks.harness.figures import Figures, all_missing, figure, missing
from benchmarks.harness.origin import ROOT
from benchmarks.harness.shell import free_port, modelgap, processes_of
from flows.service import api
from flows.service.api import Api
from flows.service.state import read_running, stop, store_key
from flows.specs.experiment import experiment_of
from flows.steps.campaign import run_all
from flows.steps.experiment import load_engine, plan
from flows.workers.processes import Processes, spread
from warehouse.query.store import open_store

_PATIENCE = 170.0  # s
_EFFICIENT, _IDLE = 0.8, 0.3


def service_figures(quick: bool) -> Figures:
    """Start a service as a user does, wait for its schedule, then time a campaign."""
    with tempfile.TemporaryDirectory(prefix="modelgap-") as folder:
        return _served(Path(folder), quick)


def _served(folder: Path, quick: bool) -> Figures:
    store = folder / "store"
    port = free_port()
    begun = monotonic()
    try:
        # Of the three commands the first is the installation, which is not timed.
        words = ("up", "--every", "10", "--port", port, "--store", str(store))
        modelgap(*words).check_returncode()
        up = monotonic() - begun
        running = read_running(store / "_prefect")
        server = Api(running.url, store_key(store / "_prefect"))
        fired = None if quick else _fired(server, begun)
        # What the schedule has started must not disturb what follows.
        home = store / "_prefect"
        stop(home, "worker")
        kept = int((home / "server.pid").read_text())
        for left in set(processes_of(store)) - {kept}:
            os.kill(left, signal.SIGKILL)
        slower = _overhead(server, folder, 8 if quick else 100)
    finally:
        modelgap("down", "--wait", "0", "--store", str(store))
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


def _overhead(to: Api, folder: Path, count: int) -> dict:
    """Time a campaign bare and as a flow, in a process that has the server's address.

    It sends the rest of its logs at its end, for which the server must still be there.
    """
    command = [sys.executable, "-m", "benchmarks.pipelines_parts.overhead"]
    where = {"PREFECT_API_URL": to.url, "PREFECT_API_AUTH_STRING": to.key}
    env = {**os.environ, "PYTHONPATH": str(ROOT), **where}
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


def _fired(to: Api, begun: float) -> float | None:
    """Return the time until a flow run of the schedule runs [s], None for never."""
    while monotonic() - begun < _PATIENCE:
        with to.client() as client:
            if any(run["start_time"] for run in api.last_runs(client)):
                return monotonic() - begun
        sleep(0.2)
    return None


def cluster_figures(quick: bool) -> Figures:
    """Run a campaign here and on a cluster, on which a worker is killed meanwhile."""
    names = ("dask_runs_that_differ", "dask_runs_lost_with_a_worker")
    if quick:
        why = "scheduler and two workers take 10 s to start; the full run has it"
        return all_missing(dict.fromkeys(names, 0), why)
    count = 8
    with tempfile.TemporaryDirectory(prefix="modelgap-") as folder:
        here, there = Path(folder) / "here", Path(folder) / "there"
        _run(here, None, count, None)
        with _cluster(folder) as (address, workers):
            _run(there, f"tcp://{address}", count, workers[0])
        ours, theirs = _hashes(here), _hashes(there)
    differ = sum(theirs.get(id, hash) != hash for id, hash in ours.items())
    return {
        names[0]: figure(differ, 0, count, what="hash of all samples"),
        names[1]: figure(len(set(ours) - set(theirs)), 0, count, killed="1 of 2"),
    }


def _run(
    store: Path, address: str | None, count: int, victim: subprocess.Popen | None
) -> None:
    motion = {"kind": "fourier", "duration": 5.0}
    contents = [{"seed": seed, "trajectory": motion} for seed in range(count)]
    specs = [experiment_of(content, "C") for content in contents]
    planned = plan(((str(s.seed), s) for s in specs), store)

    def tell(_stage: str, _share: float) -> None:
        # With the first that is done others are under way.
        if victim is not None and victim.poll() is None:
            victim.send_signal(signal.SIGKILL)

    if address is None:
        run_all(planned, store, tell)
        return
    with Client(address, set_as_default=False) as client:
        run_all(planned, store, tell, client.get_executor(pure=False))


def _hashes(store: Path) -> dict[str, str]:
    with open_store(store) as opened:
        rows = opened.sql("SELECT run_id, data_hash FROM runs").to_pylist()
    return {row["run_id"]: row["data_hash"] for row in rows}


@contextmanager
def _cluster(folder: str) -> Iterator[tuple[str, list[subprocess.Popen]]]:
    port = free_port()
    address = f"127.0.0.1:{port}"
    scheduler = _start("dask_scheduler", "--host", "127.0.0.1", "--port", port)
    options = ["--nthreads", "1", "--no-nanny", "--local-directory", folder]
    workers = [_start("dask_worker", f"tcp://{address}", *options) for _ in range(2)]
    try:
        with Client(f"tcp://{address}", timeout=60, set_as_default=False) as client:
            client.wait_for_workers(len(workers), timeout=60)
        yield address, workers
    finally:
        for process in (*workers, scheduler):
            process.kill()
            process.wait()


def _start(name: str, *words: str) -> subprocess.Popen:
    command = [sys.executable, "-m", f"distributed.cli.{name}", *words]
    return subprocess.Popen(
        [*command, "--no-dashboard"],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stderr=subprocess.DEVNULL,
    )


def efficiency_figures(quick: bool) -> Figures:
    """Return the share of the time of one process that two need, halved."""
    name = "parallel_efficiency"
    load = os.getloadavg()[0]
    if quick or load >= _IDLE:
        why = f"load average {load:.2f} before, expected under {_IDLE}"
        why = "one process alone takes the time of a quick run" if quick else why
        return {name: missing(_EFFICIENT, why)}
    count = 12
    with tempfile.TemporaryDirectory(prefix="modelgap-") as folder:
        one, two = (_seconds(Path(folder) / str(n), n, count) for n in (1, 2))
    value = one / (2 * two)
    about = {"load": load, "seconds": [round(one, 1), round(two, 1)]}
    ok = value >= _EFFICIENT
    return {name: figure(value, _EFFICIENT, count, ok=ok, at_least=True, **about)}


def _seconds(store: Path, processes: int, count: int) -> float:
    specs = [experiment_of({"seed": seed}, "C") for seed in range(count)]
    planned = plan(((str(s.seed), s) for s in specs), store)
    with Processes(processes) as pool:
        # Loaded before the clock starts, in both: a long campaign loads it once.
        list(spread(pool, _ready, [load_engine.__name__] * processes))
        start = perf_counter()
        summary = run_all(planned, store, executor=pool)
    assert not summary.failed
    return perf_counter() - start


def _ready(_: str) -> None:
    load_engine()
