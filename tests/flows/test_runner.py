"""Where experiments are computed: words, and a real Dask cluster."""

import math
import os
import signal
import subprocess
import sys
import time
from operator import attrgetter
from pathlib import Path

import pytest

from flows.workers import processes as module
from flows.workers.processes import RUNNER, TRUST, chosen_runner, executor_of, spread
from residual.errors import InputError, RunError
from tests.flows.prefect_server import free_port
from tests.waiting import PATIENCE

ROOT = Path(__file__).parents[2]


def test_the_word_decides_then_the_setting_then_threads(monkeypatch):
    monkeypatch.delenv(RUNNER, raising=False)
    assert chosen_runner() is None
    monkeypatch.setenv(RUNNER, "dask://127.0.0.1:1")
    assert chosen_runner() == "tcp://127.0.0.1:1"
    assert chosen_runner("threads") is None
    assert chosen_runner("dask") == "dask"
    assert chosen_runner("dask://127.0.0.1:8786") == "tcp://127.0.0.1:8786"
    assert chosen_runner("dask://[::1]:8786") == "tcp://[::1]:8786"


WRONG = "processes ray dask:// dask://127.0.0.1 dask://a:b tcp://a:1"


@pytest.mark.parametrize("word", WRONG.split())
def test_other_words_are_refused(word):
    with pytest.raises(InputError, match="expected threads, dask or dask://"):
        chosen_runner(word)


def test_a_cluster_on_the_network_needs_leave(monkeypatch):
    with pytest.raises(InputError, match="--trust-network"):
        chosen_runner("dask://10.0.0.7:8786")
    assert chosen_runner("dask://10.0.0.7:8786", True) == "tcp://10.0.0.7:8786"
    monkeypatch.setenv(TRUST, "1")
    assert chosen_runner("dask://10.0.0.7:8786") == "tcp://10.0.0.7:8786"


def test_a_cluster_that_is_not_there_says_how_to_start_one(monkeypatch):
    monkeypatch.setattr(module, "_PATIENCE", 1)
    with (
        pytest.raises(RunError, match="dask worker with --nthreads 1"),
        executor_of(f"tcp://127.0.0.1:{free_port()}", 1),
    ):
        pass


def _start(*words: str) -> subprocess.Popen:
    env = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-m", *words, "--no-dashboard"]
    return subprocess.Popen(command, env=env, stderr=subprocess.DEVNULL)


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """A scheduler and two workers, a process each; gives address and workers."""
    address = f"tcp://127.0.0.1:{free_port()}"
    port, place = address.rpartition(":")[2], str(tmp_path_factory.mktemp("dask"))
    more = ["--host", "127.0.0.1", "--port", port]
    scheduler = _start("distributed.cli.dask_scheduler", *more)
    options = ["--nthreads", "1", "--no-nanny", "--local-directory", place]
    workers = [_start("distributed.cli.dask_worker", address, *options) for _ in "12"]
    yield address, workers
    for process in (*workers, scheduler):
        process.kill()
        process.wait()


@pytest.mark.long
def test_a_cluster_answers_like_a_pool_and_a_lost_worker_costs_no_job(
    cluster, monkeypatch
):
    monkeypatch.setattr(module, "_PATIENCE", PATIENCE)
    address, workers = cluster
    with executor_of(address, 20) as many:
        jobs = spread(many, math.sqrt, [4.0, -1.0, 9.0])
        done = sorted(jobs, key=attrgetter("index"))
        assert [d.value for d in done] == [2.0, None, 3.0]
        assert str(done[1].error).startswith("ValueError")

        naps = spread(many, time.sleep, [0.2] * 20)
        first = next(naps)
        workers[0].send_signal(signal.SIGKILL)
        rest = list(naps)
    assert {first.index, *(d.index for d in rest)} == set(range(20))
    assert [d.error for d in rest if d.error] == []
