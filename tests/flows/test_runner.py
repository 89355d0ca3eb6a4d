"""Where flows run their tasks, by $MODELGAP_RUNNER."""

import pytest

from flows.workers import RUNNER, TRUST, read_runner_setting
from residual.errors import InputError


@pytest.mark.parametrize(
    ("word", "address"),
    [
        ("", None),
        ("threads", None),
        ("dask", "dask"),
        ("dask://127.0.0.1:8786", "tcp://127.0.0.1:8786"),
        ("dask://[::1]:8786", "tcp://[::1]:8786"),
    ],
)
def test_the_setting_says_where_tasks_run(word, address, monkeypatch):
    monkeypatch.setenv(RUNNER, word)
    assert read_runner_setting() == address


@pytest.mark.parametrize(
    "word", ["processes", "ray", "dask://", "dask://127.0.0.1", "dask://a:b", "tcp://a:1"]
)
def test_other_words_are_refused(word, monkeypatch):
    monkeypatch.setenv(RUNNER, word)
    with pytest.raises(InputError, match="expected threads, dask or dask://"):
        read_runner_setting()


def test_a_cluster_on_the_network_must_be_trusted(monkeypatch):
    monkeypatch.setenv(RUNNER, "dask://10.0.0.7:8786")
    with pytest.raises(InputError, match=f"set {TRUST}=1"):
        read_runner_setting()
    monkeypatch.setenv(TRUST, "1")
    assert read_runner_setting() == "tcp://10.0.0.7:8786"
