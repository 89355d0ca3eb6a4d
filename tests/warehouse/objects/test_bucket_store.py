"""A store in a bucket is the store that a folder is: ids, bytes, answers, damage."""

import contextlib
import json
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pyarrow.parquet as pq
import pytest

from residual.errors import InputError
from tests.warehouse import store_samples as samples
from tests.warehouse.objects.conftest import Breaking, Careless, KilledError, folder_for
from warehouse import remote_store, store_catalogue
from warehouse.bucket import open_bucket
from warehouse.queries import open_store
from warehouse.record_commit import (
    AdoptionConflictError,
    ModelAdoption,
    commit_adoption,
    commit_run,
)
from warehouse.record_ids import build_seal_path
from warehouse.remote_store import IDENTITY, record_exists
from warehouse.store_catalogue import (
    ADOPTED,
    find_record,
    list_record_folders,
    open_seal,
    quarantine_run,
    read_run,
)
from warehouse.verification import verify_store
from warehouse.view_schema import KINDS

ALL = ("runs", "models", "diagnoses")


def faults(store):
    return [(v.kind, v.id, v.faults) for v in verify_store(store) if v.faults]


def forget_copies(store, bucket, tmp_path, name="other"):
    return folder_for(bucket, tmp_path / "cache" / name)


def keys(bucket, prefix=""):
    return bucket.keys(prefix)


def test_a_run_has_id_and_the_bytes_that_it_has_in_a_folder(store, memory, tmp_path):
    here, there = samples.commit(tmp_path / "folder", 3), samples.commit(store, 3)
    assert there == here
    folder = find_record(tmp_path / "folder", here).folder
    (key,) = [k for k in keys(memory, "samples") if "part-0" in k]
    assert memory.get(key) == (folder / "part-0.parquet").read_bytes()
    other = forget_copies(store, memory, tmp_path)
    one, two = (read_run(place, here) for place in (tmp_path / "folder", other))
    for name in ("t", "q", "tau", "q_ref"):
        assert np.array_equal(getattr(one, name), getattr(two, name))
    assert open_seal(other, here).spec == samples.sealed(3).spec
    assert faults(other) == []
    assert {v.kind for v in verify_store(other)} >= {"runs", "sealed", "made_with"}


def test_sql_answers_as_from_a_folder_and_reaches_nothing_else(store, memory, tmp_path):
    for place in (tmp_path / "folder", store):
        run = samples.commit(place, 1)
        samples.commit(place, 2, robot="other")
        samples.store_verdict(place, samples.verdict([run]), {"stage": "augmented"}, [run])
    queries = (
        "SELECT * EXCLUDE created FROM runs ORDER BY run_id",
        "FROM samples ORDER BY run_id, t",
        f"SELECT avg(q2) AS a, max(e_tau1) AS b FROM samples WHERE run_id = '{run}'",
        "FROM errors ORDER BY ALL",
        "FROM effects ORDER BY ALL",
        "FROM lineage ORDER BY ALL",
    )
    other = forget_copies(store, memory, tmp_path)
    with open_store(tmp_path / "folder") as one, open_store(other) as two:
        for query in queries:
            assert one.sql(query).equals(two.sql(query)), query
        seal = f"sealed/run_id={run}/truth.parquet"
        for path in (
            f"modelgap://{seal}",
            f"modelgap://samples/../{seal}",
            f"modelgap://samples/../{IDENTITY}",
            "s3://memory/store/x.parquet",
            str(other / seal),
        ):
            with pytest.raises(InputError):
                two.sql(f"FROM read_parquet('{path}')")
        with pytest.raises(InputError, match="Only one SELECT"):
            two.sql("COPY (SELECT 1) TO 'modelgap://samples/x.parquet'")


def every_commit(store):
    run = samples.commit(store, 5)
    samples.store_verdict(store, samples.verdict([run]), {"stage": "augmented"}, [run])
    quarantine_run(store, run, "for a test")
    return run


def test_killed_at_any_change_nothing_partial_is_visible(memory, tmp_path):
    # After one change is before the next: the bucket is the same.
    seen, at, run = set(), 0, None
    while run is None:
        bucket = type(memory)(type(memory._store)(), memory.url)
        place = folder_for(Breaking(bucket, at), tmp_path / "cache" / f"killed-{at}")
        with contextlib.suppress(KilledError):
            run = every_commit(place)
        other = forget_copies(place, bucket, tmp_path, f"later-{at}")
        seen.add(check(other))
        last = every_commit(other)
        assert {len(list_record_folders(other, kind)) for kind in ALL} == {1}
        at += 1
    assert run == last
    assert check(other) == (1, 1, 1)
    assert at > 12
    assert seen == {(0, 0, 0), (1, 0, 0), (1, 1, 0), (1, 1, 1)}


def check(store):
    """Return how many runs, models and diagnoses there are; all of them are whole."""
    if not store.is_dir():
        return 0, 0, 0
    assert faults(store) == []
    with open_store(store) as opened:
        runs = opened.sql("SELECT run_id FROM runs").column(0).to_pylist()
        count = opened.sql("SELECT count(*) AS n FROM samples").to_pylist()[0]["n"]
        assert opened.damaged == ()
    for id in runs:
        assert record_exists(build_seal_path(store, id))
        assert read_run(store, id).dof == samples.DOF
    assert count == 50 * len(runs)
    return len(runs), *(len(list_record_folders(store, k)) for k in ALL[1:])


def test_a_server_that_ignores_conditions_is_refused(memory, tmp_path):
    careless = Careless(memory._store, "s3://careless")
    place = folder_for(careless, tmp_path / "cache" / "careless")
    with pytest.raises(InputError, match=r"s3://careless ignores the condition"):
        samples.commit(place)
    assert keys(memory) == [IDENTITY]


def test_two_writers_of_one_id_with_other_bits_leave_one_whole_record(
    store, memory, tmp_path, monkeypatch
):
    # As on two processors: one spec, and samples that differ in the last digit.
    log = samples.recording(1)
    run = samples.commit(store, 1)
    second = folder_for(memory, tmp_path / "cache" / "second")
    changed = samples.recording(2, q_ref=log.q)
    with monkeypatch.context() as both:
        # Neither sees the other before its last put.
        both.setattr("warehouse.record_commit._is_there", lambda *_: False)
        again = commit_run(second, changed, samples.manifest(1), samples.sealed(1))
    assert again == run
    assert len([k for k in keys(memory, "samples") if "part-0" in k]) == 2
    assert np.array_equal(read_run(second, run).q, samples.recording(1).q)
    assert faults(store) == []


def test_a_flipped_bit_in_the_bucket_is_no_result(store, memory, tmp_path):
    run, sound = samples.commit(store, 1), samples.commit(store, 2)
    (key,) = [k for k in keys(memory, "samples") if run in k and "part-0" in k]
    data = bytearray(memory.get(key))
    data[len(data) // 2] ^= 1
    memory.put(key, bytes(data))
    other = forget_copies(store, memory, tmp_path)
    with pytest.raises(InputError, match="is damaged in the bucket"):
        read_run(other, run)
    with open_store(other) as opened:
        with pytest.raises(InputError, match="damaged in the bucket"):
            opened.sql("SELECT sum(COLUMNS('[a-z]+[0-9]')), sum(t) FROM samples")
        kept = opened.sql("SELECT DISTINCT run_id FROM samples", without_damaged=True)
        assert kept.column(0).to_pylist() == [sound]
    assert [(kind, id) for kind, id, _ in faults(other)] == [("runs", run)]


def test_of_two_adoptions_with_one_number_one_is_told(store, memory, tmp_path):
    first = ModelAdoption("two_link", None, ADOPTED, None, None, None, "one")
    assert commit_adoption(store, first) == "000001"
    other = forget_copies(store, memory, tmp_path)
    with pytest.raises(AdoptionConflictError, match="one has meanwhile changed"):
        commit_adoption(other, first)
    then = ModelAdoption("two_link", None, ADOPTED, None, None, "000001", "two")
    assert commit_adoption(other, then) == "000002"
    assert sorted(list_record_folders(store, "adoptions")) == ["000001", "000002"]


def test_another_store_at_same_address_is_not_taken_for_first(store, memory, tmp_path):
    run = samples.commit(store)
    memory.delete(keys(memory))
    assert not folder_for(memory, store).is_dir()
    remote_store.close_buckets()
    folder_for(memory, store)
    new = samples.commit(store, 7)
    assert list_record_folders(store, "runs").keys() == {new}
    with pytest.raises(InputError, match="Nothing in s3://memory/store"):
        find_record(store, run)


def test_a_list_of_sums_that_names_other_places_reaches_none(store, memory, tmp_path):
    run = samples.commit(store)
    (key,) = keys(memory, "commits/samples")
    sums = json.loads(memory.get(key))
    sums["files"]["../../../../evil"] = sums["files"]["_run.parquet"]
    memory.put(key, json.dumps(sums).encode())
    other = forget_copies(store, memory, tmp_path)
    with pytest.raises(InputError, match="damaged"):
        read_run(other, run)
    assert faults(other) != []
    assert not list(tmp_path.rglob("evil"))


# The catalogue of a bucket: only a copy of rows, whoever writes it when.


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


# The bucket of a server: its conditions, its errors, and a store behind them.


def test_of_eight_writers_of_one_key_one_wins(bucket_store):
    bucket = open_bucket(bucket_store)
    with ThreadPoolExecutor(8) as beside:
        for number in range(5):
            texts = [bytes([writer]) * 1000 for writer in range(8)]
            tried = [beside.submit(bucket.put_if_absent, f"a/{number}", t) for t in texts]
            won = [t for t, each in zip(texts, tried, strict=True) if each.result()]
            assert won == [bucket.get(f"a/{number}")]


def test_what_a_store_asks_of_it(bucket_store):
    bucket = open_bucket(bucket_store)
    bucket.put("a/x/1", b"0123456789")
    bucket.put("a/y/2", b"")
    bucket.put("ab/3", b"")
    assert bucket.keys("a") == ["a/x/1", "a/y/2"]
    assert bucket.names("a") == ["x", "y"]
    assert bucket.names("a/x") == ["1"]
    bucket.delete(["a/y/2", "a/none"])
    assert bucket.get("a/y/2") is None


def test_a_bucket_that_is_not_there_and_a_server_that_is_gone_are_told(bucket_store, monkeypatch):
    with pytest.raises(InputError, match="There is no bucket for s3://not-there/a"):
        remote_store.find_local_copy("s3://not-there/a")
    monkeypatch.setattr("warehouse.bucket._RETRIES", 0)
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")
    with pytest.raises(InputError, match=r"AWS_ENDPOINT_URL"):
        remote_store.find_local_copy(bucket_store)


def test_a_store_is_there_for_who_comes_with_nothing_but_its_address(
    bucket_store, tmp_path, monkeypatch
):
    with pytest.raises(InputError, match=f"There is no store at {bucket_store}"):
        open_store(bucket_store)
    run = samples.commit(remote_store.find_local_copy(bucket_store), 1)
    monkeypatch.setenv(remote_store.CACHE, str(tmp_path / "another machine"))
    remote_store.close_buckets()
    with open_store(bucket_store) as opened:
        rows = opened.sql("SELECT run_id, avg(q1) AS q FROM samples GROUP BY run_id")
        assert [v.faults for v in verify_store(opened.path) if v.faults] == []
    assert rows.to_pylist() == [
        {"run_id": run, "q": pytest.approx(samples.recording(1).q[:, 0].mean())}
    ]
