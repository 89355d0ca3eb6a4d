"""Stores in buckets: of a server on loopback, and of nothing but memory."""

import pytest
from obstore.store import MemoryStore

from tests.warehouse.objects.buckets import folder_for
from warehouse import remote_store
from warehouse.bucket import Bucket


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
