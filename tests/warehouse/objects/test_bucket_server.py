"""The bucket of a server: its conditions, its errors, and a store behind them."""

from concurrent.futures import ThreadPoolExecutor

import pytest

from residual.errors import InputError
from tests.warehouse import store_samples as samples
from warehouse import remote_store
from warehouse.bucket import open_bucket
from warehouse.queries import open_store
from warehouse.verification import verify_store


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
