"""Stores in buckets: of a server on loopback, of nothing but memory, and some that break."""

import itertools

import pytest
from obstore.store import MemoryStore

from warehouse import remote_store
from warehouse.bucket import Bucket


class KilledError(BaseException):
    """What a kill is to a program: nothing after it is done."""


class Breaking(Bucket):
    """A bucket whose writer is killed at one of its changes."""

    def __init__(self, bucket, at):
        super().__init__(bucket._store, bucket.url)
        self._left = itertools.count(at, -1)

    def _change(self, change, *about):
        if next(self._left) <= 0:
            raise KilledError
        return change(*about)

    def put(self, key, data):
        return self._change(super().put, key, data)

    def put_if_absent(self, key, data):
        return self._change(super().put_if_absent, key, data)

    def delete(self, keys):
        return self._change(super().delete, keys)


class Careless(Bucket):
    """A server that ignores the condition of a put."""

    def put_if_absent(self, key, data):
        self.put(key, data)
        return True


def folder_for(bucket, place):
    """Return the folder of a bucket, as `remote.local_folder` does of an address."""
    remote_store.attach_bucket(place, bucket)
    return place


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv(remote_store.CACHE, str(tmp_path / "cache"))
    remote_store.close_buckets()
    yield
    remote_store.close_buckets()


@pytest.fixture
def memory():
    return Bucket(MemoryStore(), "s3://memory/store")


@pytest.fixture
def store(memory, tmp_path):
    return folder_for(memory, tmp_path / "cache" / "memory")
