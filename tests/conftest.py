"""What holds for every test: threads, examples, a clean checkout, a compiled plant."""

import fcntl
import os
import re
import sys
import tempfile
from functools import cache
from pathlib import Path

import pytest
from hypothesis import settings
from hypothesis.configuration import set_hypothesis_home_dir

from tests import s3
from tests.checkout import ROOT, changed, listing
from warehouse import remote_store

# Before numpy is loaded, so that a bare `pytest` runs as `make test` does: two test
# processes with two BLAS threads each fight over two cores.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

# The first example of a compiled function takes seconds. No run is a lottery, so there
# is nothing to remember; what hypothesis reads from the code it may keep elsewhere.
set_hypothesis_home_dir(Path(tempfile.gettempdir()) / "modelgap-hypothesis")
settings.register_profile("modelgap", deadline=None, derandomize=True, database=None)
settings.load_profile("modelgap")

_BEFORE = pytest.StashKey()
# The store of every command without --store: a test that writes there has named none.
_DEFAULT_STORE = Path(tempfile.gettempdir(), f"modelgap-no-store-{os.getpid()}")
if "PYTEST_XDIST_WORKER" not in os.environ:
    os.environ["MODELGAP_STORE"] = str(_DEFAULT_STORE)


def pytest_sessionstart(session):
    if not hasattr(session.config, "workerinput"):  # once, not in every process
        session.config.stash[_BEFORE] = listing()


def pytest_sessionfinish(session):
    before = session.config.stash.get(_BEFORE, None)
    if before is None:
        return
    touched = changed(before, listing())
    if _DEFAULT_STORE.exists():
        touched.append(f"{_DEFAULT_STORE}: the default store")
    if touched:
        reporter = session.config.get_terminal_writer()
        reporter.line("\nWritten by a test outside its own folder:", red=True)
        reporter.line("\n".join(touched))
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


@cache
def _asks_a_server(file):
    return "mark.prefect" in (ROOT / file).read_text(encoding="utf-8")


@pytest.hookimpl(optionalhook=True)  # of pytest-xdist
def pytest_xdist_make_scheduler(config, log):
    """Files in their order; those that ask a Prefect server in one process."""
    from xdist.scheduler import LoadFileScheduling

    class OneServer(LoadFileScheduling):
        def _split_scope(self, nodeid):
            file = super()._split_scope(nodeid)
            return "a server" if _asks_a_server(file) else file

    return OneServer(config, log) if config.getvalue("dist") == "loadfile" else None


@pytest.fixture
def own_folder(tmp_path, monkeypatch):
    """A folder to work in; no store is named, so that of the checkout is not read."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("MODELGAP_STORE", raising=False)
    return tmp_path


@pytest.fixture(scope="session")
def compiled_plant(tmp_path_factory):
    """Compile the plant in one process, so that all others find it on disk."""
    with (tmp_path_factory.getbasetemp().parent / "plant.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        from tests.sim.plant_cases import drive, motion

        drive(reference=motion(duration=2.0))


@pytest.fixture(scope="session")
def s3_server():
    with s3.served() as endpoint:
        yield endpoint


@pytest.fixture
def bucket_store(s3_server, tmp_path, monkeypatch):
    for name, value in s3.variables(s3_server, tmp_path / "cache").items():
        monkeypatch.setenv(name, value)
    remote_store.close_buckets()
    yield s3.new_bucket(s3_server)
    remote_store.close_buckets()


@pytest.fixture
def new_effect(tmp_path, monkeypatch):
    """Put the examples of a page beside the files of both folders; give their name."""
    from residual import effects as sought
    from sim import effects as hidden

    page = (ROOT / "docs/guide/add_an_effect.md").read_text(encoding="utf-8")
    examples, name = re.findall(r"```python\n(.*?)```", page, re.S), "creaking"
    for folder, example in zip((sought, hidden), examples, strict=True):
        copy = tmp_path / folder.__name__
        copy.mkdir()
        (copy / f"{name}.py").write_text(example, encoding="utf-8")
        monkeypatch.setattr(folder, "__path__", [*folder.__path__, str(copy)])
        folder.load_effects.cache_clear()
    yield name
    for folder in (sought, hidden):
        sys.modules.pop(f"{folder.__name__}.{name}", None)
        folder.load_effects.cache_clear()
