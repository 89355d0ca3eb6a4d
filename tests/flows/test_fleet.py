"""Many arms over workers that share nothing but a store on object storage."""

import os
import subprocess
import sys
from operator import attrgetter
from pathlib import Path

import pytest

from flows.settings import store_folder
from flows.specs.experiment import experiment_of
from flows.steps import campaign
from flows.steps.campaign import arms_of, diagnose_arms, run_all
from flows.steps.experiment import plan
from flows.workers import pool as module
from flows.workers.pool import Cluster, Here
from residual.errors import InputError
from tests import s3
from tests.waiting import PATIENCE
from tests.warehouse import store_samples as made
from warehouse import mirror
from warehouse.layout import list_folders
from warehouse.mirror import shown
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
    with Cluster(machines) as many:
        many._client.wait_for_workers(2, timeout=PATIENCE)
        jobs = [(shown(store), seed) for seed in range(8)]
        done = sorted(many.run(commit, jobs), key=attrgetter("index"))
    assert [d.error for d in done] == [None] * 8
    ids = [d.value for d in done]
    assert [len(read_run(store, id).t) for id in ids] == [50] * 8
    assert sorted(list_folders(store, "runs")) == sorted(ids)
    # Each machine wrote some of them, and nothing into its working directory.
    for number in "12":
        place = tmp_path / f"machine-{number}"
        assert list(place.glob("copies/*/samples/robot=two_link/run_id=*"))
        assert {p.name for p in place.iterdir()} <= {"copies", "dask-scratch-space"}


def test_a_campaign_gives_its_workers_the_name_of_the_store(
    bucket_store, monkeypatch, tmp_path
):
    store = store_folder(bucket_store)
    given = []

    class Elsewhere(Here):
        def run(self, work, jobs):
            given.extend(jobs)
            monkeypatch.setenv(mirror.CACHE, str(tmp_path / "another machine"))
            mirror.forget()
            return super().run(work, jobs)

    def run(spec, place, *_):
        assert place.parent == tmp_path / "another machine"
        return made.commit(place, spec.seed)

    monkeypatch.setattr(campaign.experiment, "run", run)
    specs = [("one", experiment_of({"seed": 1}, "S"))]
    summary = run_all(plan(specs, store), store, pool=Elsewhere())
    assert [job.args[1] for job in given] == [bucket_store]
    # It came back, though as another run than that of the spec.
    assert "the code was changed" in next(iter(summary.failed.values()))


@pytest.fixture
def diagnosed(monkeypatch):
    """Replace the diagnosis; returns the store and the runs that it was asked for."""
    asked = []

    def diagnose(request):
        asked.append((request.store, request.logs, request.held_out))
        if len(asked) == 2:
            raise ZeroDivisionError("a fault")
        return f"{len(asked):020x}", "0" * 20

    monkeypatch.setattr(campaign, "diagnose_runs", diagnose)
    monkeypatch.setattr(campaign, "_robots", lambda *_: {})
    monkeypatch.setattr(
        campaign, "in_force", lambda *_: type("C", (), {"diagnosis": None})
    )
    return asked


def test_what_goes_to_a_worker_is_the_name_of_the_store(
    bucket_store, tmp_path, monkeypatch, diagnosed
):
    store = store_folder(bucket_store)
    runs = [made.commit(store, seed, robot="irb140") for seed in range(3)]
    arms = {f"arm {k}": {"fit": [id]} for k, id in enumerate(runs)}
    there = tmp_path / "another machine"

    class Elsewhere(Here):
        def run(self, work, jobs):
            monkeypatch.setenv(mirror.CACHE, str(there))
            mirror.forget()
            return super().run(work, jobs)

    told = []
    found = diagnose_arms(arms, store, Elsewhere(), lambda *a: told.append(a))
    assert list(found) == ["arm 0", "arm 1", "arm 2"]
    assert [id is None for id, _ in found.values()] == [False, True, False]
    assert found["arm 1"][1] == "ZeroDivisionError: a fault"
    assert [logs for _, logs, _ in diagnosed] == [(id,) for id in runs]
    assert {place.parent for place, _, _ in diagnosed} == {there}
    assert told[-1] == ("diagnosed 3 of 3: arm 2", 1.0)


def test_an_arm_is_a_campaign_or_ids_of_runs(tmp_path):
    store = tmp_path / "store"
    runs = [made.commit(store, seed) for seed in range(2)]
    words = [f"{runs[0][:8]},{runs[1]}", runs[1]]
    arms, failed = arms_of(words, "welding", store, Here())
    assert list(arms.values()) == [{"fit": runs}, {"fit": [runs[1]]}]
    assert failed == ()
    with pytest.raises(InputError, match=r"no campaign file that is there"):
        arms_of(["night.toml"], "", store, Here())
    assert os.listdir(store / "samples") == ["robot=two_link"]
