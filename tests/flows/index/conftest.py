import pytest

from tests.flows.index.stores import fill


@pytest.fixture(scope="session")
def nights(tmp_path_factory):
    return fill(tmp_path_factory.mktemp("nights") / "store")
