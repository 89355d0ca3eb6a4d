"""The list of a bucket: a tail, catalogue files, and who appends at once."""

import numpy as np
import pytest

import warehouse
from residual.errors import InputError
from tests.warehouse import store_samples as made
from tests.warehouse.objects.buckets import mirror_for
from warehouse import catalogue, listing, mirror
from warehouse.layout import list_folders
from warehouse.listing import HEADS, read_head
from warehouse.mirror import TAIL, note_key


def fill(store, count, start=0):
    return {made.commit(store, seed) for seed in range(start, start + count)}


def keys(bucket, prefix):
    return [each.key for each in bucket.objects(prefix)]


def listed(store):
    with warehouse.open(store) as opened:
        ids = opened.sql("SELECT run_id FROM runs").column(0).to_pylist()
    assert sorted(ids) == list(list_folders(store, "runs"))
    return set(ids)


@pytest.fixture
def began(store):
    """A store with a catalogue of three runs."""
    ids = fill(store, 3)
    assert listed(store) == ids
    # As if another process had written them.
    catalogue.forget_waiting()
    return ids


def test_what_is_in_no_catalogue_yet_is_listed(store, memory, began, tmp_path):
    more = fill(store, 2, 3)
    other = mirror_for(memory, tmp_path / "cache" / "other")
    assert listed(other) == began | more
    assert len(keys(memory, TAIL)) == 2
    assert read_head(memory).number == 1


def test_a_writer_adds_its_rows_and_clears_its_notes(store, memory, began, monkeypatch):
    monkeypatch.setattr(catalogue, "SIZE", 4)
    more = fill(store, 4, 3)
    assert keys(memory, TAIL) == []
    assert [count for _, count in read_head(memory).files["runs"]] == [3, 4]
    assert listed(store) == began | more


def test_a_writer_adds_nothing_that_a_reader_has_added(
    store, memory, began, tmp_path, monkeypatch
):
    monkeypatch.setattr(catalogue, "_SPARE", 1)
    more = fill(store, 2, 3)
    assert listed(mirror_for(memory, tmp_path / "cache" / "other")) == began | more
    catalogue.flush()
    assert [count for _, count in read_head(memory).files["runs"]] == [3, 2]


def test_of_two_that_append_at_once_none_is_lost(
    store, memory, began, tmp_path, monkeypatch
):
    monkeypatch.setattr(catalogue, "SIZE", 2)
    second = mirror_for(memory, tmp_path / "cache" / "second")
    real, between = memory.put_if_absent, []

    def slow(key, data):
        # Between its look at the head and its own, another writes one: three times.
        if key.startswith(HEADS) and len(between) < 3:
            between.append(key)
            fill(second, 2, 10 + 2 * len(between))
        return real(key, data)

    monkeypatch.setattr(memory, "put_if_absent", slow)
    more = fill(store, 2, 3)
    assert len(between) == 3
    assert more <= listed(store)
    assert len(listed(store)) == 3 + 2 + 6
    assert keys(memory, TAIL) == []


def test_a_note_without_a_record_is_no_record(store, memory, began):
    memory.put(note_key(f"samples/robot=two_link/run_id={'ab' * 10}"), b"")
    memory.put(f"{TAIL}/nonsense/-/ab", b"")
    assert listed(store) == began


def test_between_its_look_at_the_tail_and_at_the_head_a_reader_loses_nothing(
    store, memory, began, tmp_path, monkeypatch
):
    more = fill(store, 2, 3)
    other = mirror_for(memory, tmp_path / "cache" / "other")
    real = memory.objects

    def moved(prefix):
        found = real(prefix)
        if prefix == TAIL and found:
            monkeypatch.setattr(memory, "objects", real)
            catalogue.flush()
            assert real(TAIL) == []
        return found

    monkeypatch.setattr(memory, "objects", moved)
    assert set(list_folders(other, "runs")) == began | more


def test_the_whole_index_may_be_deleted(store, memory, began, tmp_path):
    memory.delete(keys(memory, "_index"))
    other = mirror_for(memory, tmp_path / "cache" / "other")
    assert listed(other) == began
    assert read_head(memory).number == 1


def test_a_damaged_catalogue_says_how_it_is_made_again(store, memory, began, tmp_path):
    memory.put(keys(memory, HEADS)[-1], b"{")
    other = mirror_for(memory, tmp_path / "cache" / "other")
    with pytest.raises(InputError, match="Delete _index of the bucket"):
        warehouse.open(other)
    memory.delete(keys(memory, "_index"))
    assert listed(other) == began


def test_files_of_one_size_are_joined_and_old_ones_cleared_away(
    store, memory, began, monkeypatch
):
    monkeypatch.setattr(catalogue, "SIZE", 1)
    monkeypatch.setattr(listing, "_OLD_FILE", listing._OLD_FILE * 0)
    more = fill(store, 20, 3)
    files = read_head(memory).files["runs"]
    assert sum(count for _, count in files) == 23
    assert len(files) < listing._FAN
    assert len(keys(memory, HEADS)) == listing._HEADS_KEPT
    # Those of the last heads, and none of the twenty before.
    assert len(keys(memory, "_index/files")) < 15
    mirror.forget()
    assert listed(mirror_for(memory, store)) == began | more


def test_rows_of_another_version_are_read_from_their_records(
    store, memory, began, tmp_path, monkeypatch
):
    head = read_head(memory)
    (name, _), *_ = head.files["runs"]
    rows = listing.read_rows(store, head, catalogue.KINDS["runs"])
    (made_,) = listing._write(memory, "runs", rows.drop_columns(["seed"]))
    key = f"_index/files/{name}.parquet"
    memory.put(key, memory.get(f"_index/files/{made_[0]}.parquet"))
    other = mirror_for(memory, tmp_path / "cache" / "other")
    with warehouse.open(other) as opened:
        seeds = opened.sql("SELECT seed FROM runs").column(0).to_pylist()
    assert np.array_equal(sorted(seeds), [0, 1, 2])
