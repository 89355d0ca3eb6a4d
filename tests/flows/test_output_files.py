"""Files are written whole or not at all."""

import os

import pytest

from flows.outputs import write_files


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
