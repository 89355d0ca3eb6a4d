import pytest

from tests.flows.index.stores import fill


@pytest.fixture(scope="session")
def nights(tmp_path_factory):
    """A store that no test changes."""
    return fill(tmp_path_factory.mktemp("nights") / "store")
