"""Rows that are still coming: half lines, other files, a pipe that ends."""

import json
import os

import numpy as np
import pytest

from flows.inputs.given import load
from flows.inputs.stream import GrowingFile, StandardInput
from residual.errors import InputError
from warehouse.logs.columns import ColumnMap

ARM = load("irb140"), ColumnMap()
HEADER = ",".join(["t", *(f"{n}{j}" for n in ("q", "tau") for j in range(1, 7))])


def row(t: float) -> str:
    return ",".join([f"{t}", *["0.1"] * 6, *["2"] * 6])


def everything(source) -> list[float]:
    """Times of all that is there."""
    times = []
    for _ in range(6):
        batch = source.read()
        if batch.samples is not None:
            times += batch.samples.t.tolist()
    return times


def test_half_a_line_is_waited_for(tmp_path):
    path = tmp_path / "live.csv"
    source = GrowingFile(path, *ARM)
    assert everything(source) == []  # not even there
    path.write_text(HEADER[:20])
    assert everything(source) == []
    path.write_text(f"{HEADER}\n{row(1)}\n{row(2)[:9]}")
    assert everything(source) == [1.0]
    with path.open("a") as file:
        file.write(f"{row(2)[9:]}\n")
    assert everything(source) == [2.0]


def test_a_file_goes_on_where_it_was_left(tmp_path):
    path = tmp_path / "live.csv"
    path.write_text(f"{HEADER}\n{row(1)}\n")
    first = GrowingFile(path, *ARM)
    assert everything(first) == [1.0]
    with path.open("a") as file:
        file.write(f"{row(2)}\n")
    place = json.loads(json.dumps(first.position()))
    assert everything(GrowingFile(path, *ARM, place)) == [2.0]


@pytest.mark.parametrize("text", [row(5), f"{row(5)}\n{row(6)}\n{row(7)}\n{row(8)}"])
def test_a_file_that_was_replaced_is_said_to_be_and_read_from_its_begin(tmp_path, text):
    path = tmp_path / "live.csv"
    path.write_text(f"{HEADER}\n{row(1)}\n{row(2)}\n{row(3)}\n")
    source = GrowingFile(path, *ARM)
    assert len(everything(source)) == 3
    path.write_text(f"{HEADER}\n{text}\n")
    batch = source.read()
    assert "was replaced" in batch.notes[0]
    assert batch.samples.t[0] == 5.0


def test_values_that_are_no_numbers_are_none_and_short_lines_too(tmp_path):
    path = tmp_path / "live.csv"
    path.write_text(f"{HEADER}\n{row(1)}\n{row(2).replace('2,2', 'x,2', 1)}\n3,4\n")
    samples = GrowingFile(path, *ARM).read().samples
    assert np.isfinite(samples.tau).all(axis=1).tolist() == [True, False, False]


def test_json_lines_come_down_a_pipe(monkeypatch):
    read, write = os.pipe()
    with os.fdopen(read) as stdin, os.fdopen(write, "wb", buffering=0) as sender:
        monkeypatch.setattr("sys.stdin", stdin)
        source = StandardInput(*ARM)
        assert source.read().samples is None  # it waits for nobody
        first = json.dumps({"t": 1.0, "q": [0.1] * 6, "tau": [2.0] * 6}).encode()
        sender.write(first + b"\n" + first[:10])
        assert source.read().samples.t.tolist() == [1.0]
        assert not source.ended
        sender.close()
        assert "middle of a line" in source.read().notes[0]
        assert source.ended


LONG = b"9" * (5 << 19)  # two and a half megabytes without an end of line


def test_a_line_without_end_is_left_out_of_a_file(tmp_path):
    path = tmp_path / "live.csv"
    path.write_bytes(f"{HEADER}\n{row(1)}\n".encode() + LONG)
    source = GrowingFile(path, *ARM)
    batches = [source.read() for _ in range(5)]
    assert [n for b in batches for n in b.notes] == [
        "live.csv: a line of more than 1048576 bytes was left out: no row has so many"
    ]
    with path.open("a") as file:
        file.write(f"\n{row(2)}\n{row(3)}\n")
    assert everything(source) == [2.0, 3.0]
    path.write_bytes(LONG)
    with pytest.raises(InputError, match="its line of names"):
        GrowingFile(path, *ARM).read()


def test_a_line_without_end_is_left_out_of_a_pipe(monkeypatch):
    read, write = os.pipe()
    with os.fdopen(read) as stdin, os.fdopen(write, "wb", buffering=0) as sender:
        monkeypatch.setattr("sys.stdin", stdin)
        source, notes, times = StandardInput(*ARM), [], []
        sent = f"{HEADER}\n{row(1)}\n".encode() + LONG + f"\n{row(2)}\n".encode()
        for start in range(0, len(sent), 1 << 15):
            sender.write(sent[start : start + (1 << 15)])
            batch = source.read()
            notes += batch.notes
            times += [] if batch.samples is None else batch.samples.t.tolist()
        assert times == [1.0, 2.0]
        assert len(notes) == 1


@pytest.mark.parametrize(
    "line", ["x" * 500_000, "[" * 100_000, '{"t": ' + "9" * 400 + "}", "\0\0,\0"]
)
def test_a_line_made_to_break_its_reader_is_a_row_without_numbers(tmp_path, line):
    for header in (HEADER, json.dumps({"t": 0.5, "q": [0.1] * 6, "tau": [2.0] * 6})):
        path = tmp_path / "live.csv"
        path.write_text(f"{header}\n{line}\n")
        samples = GrowingFile(path, *ARM).read().samples
        assert np.isnan(samples.t[-1]) or not np.isfinite(samples.q[-1]).all()
