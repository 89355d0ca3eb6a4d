"""Commits that are killed, or made by several at once, leave a consistent store."""

import multiprocessing
import random
import time

import pytest

from tests.waiting import PATIENCE
from tests.warehouse import store_samples as samples
from tests.warehouse.store_campaign import RUNS, campaign
from warehouse.queries import open_store
from warehouse.store_catalogue import list_record_folders, open_seal, read_run

KILLS = 6


@pytest.fixture(scope="module")
def processes():
    """Fresh processes that start at once: all is imported where they fork from."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["tests.warehouse.store_campaign"])
    return context


def check(store):
    with open_store(store) as opened:
        rows = opened.sql(
            "SELECT run_id, count(t) AS n FROM runs LEFT JOIN samples USING (run_id) "
            "GROUP BY run_id"
        ).to_pylist()
        orphans = "SELECT model_id FROM diagnoses EXCEPT SELECT model_id FROM models"
        assert opened.sql(orphans).num_rows == 0
        assert opened.damaged == ()
    assert {row["n"] for row in rows} <= {50}
    ids = [row["run_id"] for row in rows]
    for id in ids:
        assert read_run(store, id).dof == samples.DOF
        assert open_seal(store, id).truth["q"].shape == (50, samples.DOF)
    return ids


def content(store):
    """Every value in the store, but for times of commits and the state of git."""
    with open_store(store) as opened:
        views = ("samples", "errors")
        tables = {view: opened.sql(f"FROM {view} ORDER BY ALL") for view in views}
        known = "SELECT * EXCLUDE (created, commit, dirty) FROM runs ORDER BY ALL"
        tables["runs"] = opened.sql(known)
        return {name: table.to_pylist() for name, table in tables.items()}


def test_killed_at_any_moment_it_is_consistent_and_completable(tmp_path, processes):
    rng = random.Random(7)
    calm, killed = tmp_path / "calm", tmp_path / "killed"
    last = campaign(calm)
    seen = []
    for kill in range(KILLS):
        # A new store now and then, so that kills meet every stage of a campaign.
        store = killed / str(kill // 3)
        started = processes.Event()
        process = processes.Process(target=campaign, args=(store, started))
        process.start()
        assert started.wait(PATIENCE)
        # Some runs further than before, and then at any moment of the next.
        wanted = len(list_record_folders(store, "runs")) + rng.randrange(3)
        while len(list_record_folders(store, "runs")) < wanted and process.is_alive():
            time.sleep(0.001)
        time.sleep(rng.uniform(0, 0.05))
        process.kill()
        process.join()
        store.mkdir(parents=True, exist_ok=True)
        seen.append(len(check(store)))
    assert len(set(seen)) > 2
    for store in killed.iterdir():
        assert campaign(store) == last
        assert content(store) == content(calm)


def test_three_writers_of_the_same_and_of_other_runs_at_once(tmp_path, processes):
    writers = [processes.Process(target=campaign, args=(tmp_path,)) for _ in range(3)]
    for writer in writers:
        writer.start()
    # A reader among them never sees half a run.
    while any(writer.is_alive() for writer in writers):
        assert len(check(tmp_path)) <= RUNS
    for writer in writers:
        writer.join()
    assert [writer.exitcode for writer in writers] == [0, 0, 0]
    assert len(check(tmp_path)) == RUNS
    assert len(list_record_folders(tmp_path, "diagnoses")) == 1
    assert list((tmp_path / "_staging").iterdir()) == []
