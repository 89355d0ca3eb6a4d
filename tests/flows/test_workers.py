"""Where jobs run, and files that are written whole or not at all."""

import os

import pytest

from flows.outputs import write_files
from flows.settings import resolve_store_folder
from flows.specs import parse_spec
from flows.steps import experiment as campaign
from flows.steps.experiment import plan_experiments, run_campaign_experiments
from flows.workers import RUNNER, TRUST, InlineExecutor, read_runner_setting
from residual.errors import InputError
from tests.warehouse import store_samples as samples
from warehouse import remote_store

# Where flows run their tasks, by $MODELGAP_RUNNER.


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


# A campaign whose workers share only a store on object storage.


def test_a_campaign_gives_its_workers_the_name_of_the_store(bucket_store, monkeypatch, tmp_path):
    store = resolve_store_folder(bucket_store)
    given = []

    class Elsewhere(InlineExecutor):
        def submit(self, work, *words):
            given.append(words[0].keywords["store"])
            monkeypatch.setenv(remote_store.CACHE, str(tmp_path / "another machine"))
            remote_store.close_buckets()
            return super().submit(work, *words)

    def run(spec, place, *_):
        assert place.parent == tmp_path / "another machine"
        return samples.commit(place, spec.seed)

    monkeypatch.setattr(campaign, "simulate_and_store", run)
    specs = [("one", parse_spec({"seed": 1}, "S"))]
    summary = run_campaign_experiments(plan_experiments(specs, store), store, executor=Elsewhere())
    assert given == [bucket_store]
    # It came back, though as another run than that of the spec.
    assert "the code has changed" in next(iter(summary.failed.values()))


# Files are written whole or not at all.


def test_a_file_is_replaced_a_link_stays_one_and_nothing_is_left_over(tmp_path):
    for name in "ac":
        (tmp_path / name).write_text("old")
    (tmp_path / "link").symlink_to(tmp_path / "c")
    write_files({tmp_path / name: f"new {name}" for name in ("a", "b", "link")})
    contents = {p.name: p.read_text() for p in tmp_path.iterdir()}
    assert contents == {"a": "new a", "b": "new b", "c": "new link", "link": "new link"}
    assert (tmp_path / "link").is_symlink()


def test_a_failed_write_keeps_the_old_file(tmp_path, monkeypatch):
    def fail(_):
        raise OSError("disk full")

    (tmp_path / "a").write_text("old")
    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(OSError, match="disk full"):
        write_files({tmp_path / "a": "new"})
    assert (tmp_path / "a").read_text() == "old"
    assert os.listdir(tmp_path) == ["a"]


def test_a_pipe_is_written_to_and_not_replaced(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    reader = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    write_files({tmp_path / "pipe": "text"})
    assert os.read(reader, 10) == b"text"
    os.close(reader)
    assert (tmp_path / "pipe").is_fifo()
