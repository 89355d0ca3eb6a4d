"""Files are written whole or not at all."""

import os
from pathlib import Path

import pytest

from flows.outputs import check_writable, write_all
from residual.errors import InputError


def test_an_existing_file_is_replaced_and_nothing_is_left_over(tmp_path):
    (tmp_path / "a").write_text("old")
    write_all({tmp_path / "a": "new", tmp_path / "b": "second"})
    assert (tmp_path / "a").read_text() == "new"
    assert sorted(os.listdir(tmp_path)) == ["a", "b"]


def test_a_failed_write_keeps_the_old_file(tmp_path, monkeypatch):
    def fail(_):
        raise OSError("disk full")

    (tmp_path / "a").write_text("old")
    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(OSError, match="disk full"):
        write_all({tmp_path / "a": "new"})
    assert (tmp_path / "a").read_text() == "old"
    assert os.listdir(tmp_path) == ["a"]


def test_a_link_stays_a_link(tmp_path):
    (tmp_path / "a").write_text("old")
    (tmp_path / "link").symlink_to(tmp_path / "a")
    write_all({tmp_path / "link": "new"})
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "a").read_text() == "new"


def test_a_pipe_is_written_to_and_not_replaced(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    reader = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    write_all({tmp_path / "pipe": "text"})
    assert os.read(reader, 10) == b"text"
    os.close(reader)
    assert (tmp_path / "pipe").is_fifo()


@pytest.mark.parametrize(
    ("files", "message"),
    [
        ({"--report": "none/a"}, "there is no folder"),
        ({"--report": "."}, "is a folder"),
        ({"--report": "in"}, "overwrite an input"),
        ({"--report": "link"}, "overwrite an input"),
        ({"--report": "a", "--json": "./a"}, "both name"),
    ],
)
def test_what_cannot_be_written_is_refused_early(tmp_path, monkeypatch, files, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "in").touch()
    (tmp_path / "link").symlink_to(tmp_path / "in")
    with pytest.raises(InputError, match=message):
        check_writable({k: Path(v) for k, v in files.items()}, [Path("in")])
