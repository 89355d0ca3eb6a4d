"""A campaign over workers that share nothing but a store on object storage."""

import subprocess
import sys
from operator import attrgetter
from pathlib import Path

import pytest

from flows.settings import store_folder
from flows.specs.experiment import experiment_of
from flows.steps import campaign
from flows.steps.campaign import run_all
from flows.steps.experiment import plan
from flows.workers import processes as module
from flows.workers.processes import Here, executor_of, spread
from tests import s3
from tests.waiting import PATIENCE
from tests.warehouse import store_samples as made
from warehouse import remote
from warehouse.layout import list_folders
from warehouse.remote import shown
from warehouse.runs import read_run

ROOT = Path(__file__).parents[2]
_SCHEDULER = """
import sys
from distributed import LocalCluster
with LocalCluster(n_workers=0, host="127.0.0.1", dashboard_address=None) as own:
    print(own.scheduler_address, flush=True)
    sys.stdin.read()
"""
_DASK = "distributed.cli.dask_worker"
_WORKER = (sys.executable, "-m", _DASK, "--no-dashboard", "--no-nanny")


@pytest.fixture
def machines(bucket_store, s3_server, tmp_path):
    """A cluster of two workers with a working directory and copies of their own."""
    environment = s3.environment(s3_server, tmp_path / "cache")
    environment |= {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    scheduler = subprocess.Popen(
        [sys.executable, "-c", _SCHEDULER],
        env=environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    address = scheduler.stdout.readline().strip()
    workers = []
    for number in "12":
        place = tmp_path / f"machine-{number}"
        place.mkdir()
        own = environment | {"MODELGAP_CACHE": str(place / "copies")}
        words = [*_WORKER, "--nthreads", "1", "--local-directory", str(place), address]
        quiet = subprocess.DEVNULL
        workers.append(subprocess.Popen(words, env=own, cwd=place, stderr=quiet))
    yield address
    for process in (*workers, scheduler):
        process.kill()
        process.wait()


def commit(job):
    """Put a run into the store of a name; work of a module that workers have too."""
    name, seed = job
    return made.commit(store_folder(name), seed)


@pytest.mark.long
def test_machines_share_a_store_and_no_disk(
    machines, bucket_store, tmp_path, monkeypatch
):
    monkeypatch.setattr(module, "_PATIENCE", PATIENCE)
    store = store_folder(bucket_store)
    with executor_of(machines, 8) as many:
        jobs = [(shown(store), seed) for seed in range(8)]
        done = sorted(spread(many, commit, jobs), key=attrgetter("index"))
    assert [d.error for d in done] == [None] * 8
    ids = [d.value for d in done]
    assert [len(read_run(store, id).t) for id in ids] == [50] * 8
    assert sorted(list_folders(store, "runs")) == sorted(ids)
    # Each machine wrote some of them, and nothing into its working directory.
    for number in "12":
        place = tmp_path / f"machine-{number}"
        assert list(place.glob("copies/*/made_with/*"))
        assert {p.name for p in place.iterdir()} <= {"copies", "dask-scratch-space"}


def test_a_campaign_gives_its_workers_the_name_of_the_store(
    bucket_store, monkeypatch, tmp_path
):
    store = store_folder(bucket_store)
    given = []

    class Elsewhere(Here):
        def submit(self, work, *words):
            given.append(words[0].keywords["store"])
            monkeypatch.setenv(remote.CACHE, str(tmp_path / "another machine"))
            remote.forget()
            return super().submit(work, *words)

    def run(spec, place, *_):
        assert place.parent == tmp_path / "another machine"
        return made.commit(place, spec.seed)

    monkeypatch.setattr(campaign.experiment, "run", run)
    specs = [("one", experiment_of({"seed": 1}, "S"))]
    summary = run_all(plan(specs, store), store, executor=Elsewhere())
    assert given == [bucket_store]
    # It came back, though as another run than that of the spec.
    assert "the code was changed" in next(iter(summary.failed.values()))
