"""The catalogue of a bucket: only a copy of rows, whoever writes it when."""

import numpy as np
import pyarrow.parquet as pq
import pytest

from tests.warehouse import store_samples as samples
from tests.warehouse.objects.buckets import folder_for
from warehouse import store_catalogue
from warehouse.queries import open_store
from warehouse.store_catalogue import list_record_folders
from warehouse.view_schema import KINDS


def fill(store, count, start=0):
    return {samples.commit(store, seed) for seed in range(start, start + count)}


def row_count(bucket, tmp_path):
    """How many rows the one file of the catalogue has."""
    (tmp_path / "rows.parquet").write_bytes(bucket.get("_index/runs.parquet"))
    return pq.read_metadata(tmp_path / "rows.parquet").num_rows


def run_ids(store):
    with open_store(store) as opened:
        return set(opened.sql("SELECT run_id FROM runs").column(0).to_pylist())


def listed(store):
    ids = run_ids(store)
    assert sorted(ids) == list(list_record_folders(store, "runs"))
    return ids


@pytest.fixture
def began(store):
    ids = fill(store, 3)
    assert listed(store) == ids
    return ids


def test_what_is_in_no_catalogue_yet_is_listed(store, memory, began, tmp_path):
    more = fill(store, 2, 3)
    assert listed(folder_for(memory, tmp_path / "cache" / "other")) == began | more


def test_of_two_that_join_no_record_is_lost(store, memory, began, tmp_path, monkeypatch):
    monkeypatch.setattr(store_catalogue, "_SPARE", 0)
    more, real, between = fill(store, 2, 3), memory.put, []

    def slow(key, data):
        if key == "_index/runs.parquet" and not between:
            between.append(key)
            # Before its index is there, another reader writes one with a further run.
            between.extend(fill(folder_for(memory, tmp_path / "cache" / "two"), 1, 10))
            listed(folder_for(memory, tmp_path / "cache" / "three"))
        real(key, data)

    monkeypatch.setattr(memory, "put", slow)
    assert run_ids(folder_for(memory, tmp_path / "cache" / "other")) == began | more
    assert len(between) == 2
    last = folder_for(memory, tmp_path / "cache" / "last")
    assert listed(last) == began | more | set(between[1:])


def test_a_commit_of_another_form_is_no_record(store, memory, began):
    memory.put("commits/samples/robot=UP/run_id=ab.json", b"{}")
    memory.put("commits/nonsense", b"")
    assert listed(store) == began


def test_the_whole_index_may_be_deleted_or_damaged(store, memory, began, tmp_path):
    memory.delete(memory.keys("_index"))
    assert listed(folder_for(memory, tmp_path / "cache" / "other")) == began
    memory.put("_index/runs.parquet", b"PAR1")
    assert listed(folder_for(memory, tmp_path / "cache" / "third")) == began
    assert row_count(memory, tmp_path) == 3


def test_rows_of_another_version_are_read_from_records(store, memory, began, tmp_path):
    path = tmp_path / "runs.parquet"
    path.write_bytes(memory.get("_index/runs.parquet"))
    pq.write_table(pq.read_table(path).drop_columns(["seed"]), path)
    memory.put("_index/runs.parquet", path.read_bytes())
    other = folder_for(memory, tmp_path / "cache" / "other")
    with open_store(other) as opened:
        seeds = opened.sql("SELECT seed FROM runs").column(0).to_pylist()
    assert np.array_equal(sorted(seeds), [0, 1, 2])
    assert "seed" in KINDS["runs"].fields.names
