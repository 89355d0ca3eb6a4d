"""The index: a copy that makes many runs quick, and nothing more."""

import resource
import shutil
from contextlib import contextmanager

import pytest

from residual.errors import InputError
from tests.warehouse import store_samples as samples
from tests.warehouse.store_samples import ask
from warehouse.queries import open_store
from warehouse.store_catalogue import find_run

SUMS = "SELECT run_id, count(*) AS n, sum(q1) AS q, sum(tau2) AS tau FROM samples"
QUERY = f"{SUMS} GROUP BY run_id ORDER BY run_id"


def test_the_index_may_have_more_or_fewer_rows_than_there_are_runs(tmp_path):
    ids = [samples.commit(tmp_path, seed) for seed in range(4)]
    assert sorted(r["run_id"] for r in ask(tmp_path, QUERY)) == sorted(ids)
    assert [p.name for p in (tmp_path / "_index").iterdir()] == ["runs.parquet"]
    shutil.rmtree(find_run(tmp_path, ids[-1]).folder)
    more = samples.commit(tmp_path, 20)
    rows = ask(tmp_path, "FROM runs")
    assert sorted(row["run_id"] for row in rows) == sorted([*ids[:-1], more])


@contextmanager
def files_up_to(size):
    """Let no file grow beyond a size, as a full disk does."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_full_disk_fails_the_run_and_not_the_store(tmp_path):
    first = samples.commit(tmp_path, 0)
    with files_up_to(30_000), pytest.raises(OSError, match="too large"):
        samples.commit(tmp_path, 1, rows=5000)
    assert [r["run_id"] for r in ask(tmp_path, QUERY)] == [first]
    assert list((tmp_path / "_staging").iterdir()) == []
    again = samples.commit(tmp_path, 1, rows=5000)
    counts = {r["run_id"]: r["n"] for r in ask(tmp_path, QUERY)}
    assert counts == {first: 50, again: 5000}


def test_a_full_disk_does_not_stop_questions(tmp_path):
    ids = [samples.commit(tmp_path, seed) for seed in range(3)]
    with files_up_to(100):
        assert [r["run_id"] for r in ask(tmp_path, QUERY)] == sorted(ids)


def test_an_answer_that_no_memory_holds_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("warehouse.sql_guard.read_machine_memory", lambda: 400_000_000)
    with open_store(tmp_path) as store:
        with pytest.raises(InputError, match=r"larger than 0\.093 GB, a quarter of .* Ask"):
            store.sql("FROM range(1000000000000)")
        with pytest.raises(InputError, match="Out of Memory"):
            store.sql("SELECT list(i) FROM range(1000000000) t(i)")
        assert store.sql("SELECT 1 AS n").to_pylist() == [{"n": 1}]
