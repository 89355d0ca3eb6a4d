"""Stores in buckets: of a server on loopback, and of nothing but memory."""

import pytest
from obstore.store import MemoryStore

from tests.warehouse.objects.buckets import folder_for
from warehouse import remote
from warehouse.bucket import Bucket


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    """Mirrors of a test's own, and no bucket known from another."""
    monkeypatch.setenv(remote.CACHE, str(tmp_path / "cache"))
    remote.forget_buckets()
    yield
    remote.forget_buckets()


@pytest.fixture
def memory():
    """A bucket that is nowhere but in this process."""
    return Bucket(MemoryStore(), "s3://memory/store")


@pytest.fixture
def store(memory, tmp_path):
    """A store in that bucket."""
    return folder_for(memory, tmp_path / "cache" / "memory")
