"""A real Dask cluster on 127.0.0.1: the same bits, and no run lost with a worker."""

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from benchmarks.figures import ROOT, Figures, figure, missing


def cluster_figures(folder: Path, quick: bool) -> Figures:
    """Run a campaign here and on a cluster, on which a worker is killed meanwhile."""
    names = ("dask_runs_that_differ", "dask_runs_lost_with_a_worker")
    if quick:
        why = "scheduler and two workers take 10 s to start; the full run has it"
        return {name: missing(0, why) for name in names}
    count = 8
    here, there = folder / "here", folder / "there"
    _run(here, "threads", count, None)
    with _cluster(folder) as (address, workers):
        _run(there, f"dask://{address}", count, workers[0])
    ours, theirs = _hashes(here), _hashes(there)
    differ = sum(theirs.get(id, hash) != hash for id, hash in ours.items())
    return {
        names[0]: figure(differ, 0, count, what="hash of all samples"),
        names[1]: figure(len(set(ours) - set(theirs)), 0, count, killed="1 of 2"),
    }


def _run(store: Path, word: str, count: int, victim: subprocess.Popen | None) -> None:
    from flows.specs.experiment import experiment_of
    from flows.steps.campaign import run_all
    from flows.steps.experiment import plan
    from flows.workers.runner import chosen_runner, workers_of

    motion = {"kind": "fourier", "duration": 5.0}
    contents = [{"seed": seed, "trajectory": motion} for seed in range(count)]
    specs = [experiment_of(content, "C") for content in contents]
    planned = plan(((str(s.seed), s) for s in specs), store)

    def tell(_stage: str, _share: float) -> None:
        # With the first that is done others are under way.
        if victim is not None and victim.poll() is None:
            victim.send_signal(signal.SIGKILL)

    with workers_of(chosen_runner(word), count) as pool:
        run_all(planned, store, tell, pool)


def _hashes(store: Path) -> dict[str, str]:
    from warehouse.query.store import open_store

    with open_store(store) as opened:
        rows = opened.sql("SELECT run_id, data_hash FROM runs").to_pylist()
    return {row["run_id"]: row["data_hash"] for row in rows}


@contextmanager
def _cluster(folder: Path) -> Iterator[tuple[str, list[subprocess.Popen]]]:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = str(probe.getsockname()[1])
    address = f"127.0.0.1:{port}"
    scheduler = _start("dask_scheduler", "--host", "127.0.0.1", "--port", port)
    options = ["--nthreads", "1", "--no-nanny", "--local-directory", str(folder)]
    workers = [_start("dask_worker", f"tcp://{address}", *options) for _ in range(2)]
    try:
        _wait_for(address, len(workers))
        yield address, workers
    finally:
        for process in (*workers, scheduler):
            process.kill()
            process.wait()


def _wait_for(address: str, workers: int) -> None:
    from distributed import Client

    with Client(f"tcp://{address}", timeout=60, set_as_default=False) as client:
        client.wait_for_workers(workers, timeout=60)


def _start(name: str, *words: str) -> subprocess.Popen:
    command = [sys.executable, "-m", f"distributed.cli.{name}", *words]
    return subprocess.Popen(
        [*command, "--no-dashboard"],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stderr=subprocess.DEVNULL,
    )
