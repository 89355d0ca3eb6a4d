"""Rows that are still coming: half lines, other files, other machines."""

import json
import socket

import numpy as np
import pytest

from flows.inputs.robots import load
from flows.inputs.stream.file import GrowingFile
from flows.inputs.stream.folder import FillingFolder
from flows.inputs.stream.socket import LocalPort
from flows.inputs.stream.source import Meaning
from residual.errors import InputError
from warehouse.logs.columns import ColumnMap

ROBOT = load("irb140")
MEANING = Meaning(ROBOT, ColumnMap())
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
    source = GrowingFile.at(path, MEANING, None)
    assert everything(source) == []  # not even there
    path.write_text(HEADER[:20])
    assert everything(source) == []
    path.write_text(f"{HEADER}\n{row(1)}\n{row(2)[:9]}")
    assert everything(source) == [1.0]
    assert source.unfinished()
    with path.open("a") as file:
        file.write(f"{row(2)[9:]}\n")
    assert everything(source) == [2.0]
    assert not source.unfinished()


def test_a_file_goes_on_where_it_was_left(tmp_path):
    path = tmp_path / "live.csv"
    path.write_text(f"{HEADER}\n{row(1)}\n")
    first = GrowingFile.at(path, MEANING, None)
    assert everything(first) == [1.0]
    with path.open("a") as file:
        file.write(f"{row(2)}\n")
    place = json.loads(json.dumps(first.position()))
    assert everything(GrowingFile.at(path, MEANING, place)) == [2.0]


@pytest.mark.parametrize("text", [row(5), f"{row(5)}\n{row(6)}\n{row(7)}\n{row(8)}"])
def test_a_file_that_was_replaced_is_said_to_be_and_read_from_its_begin(tmp_path, text):
    path = tmp_path / "live.csv"
    path.write_text(f"{HEADER}\n{row(1)}\n{row(2)}\n{row(3)}\n")
    source = GrowingFile.at(path, MEANING, None)
    assert len(everything(source)) == 3
    path.write_text(f"{HEADER}\n{text}\n")
    batch = source.read()
    assert "was replaced" in batch.notes[0]
    assert batch.samples.t[0] == 5.0


def test_values_that_are_no_numbers_are_none_and_short_lines_too(tmp_path):
    path = tmp_path / "live.csv"
    path.write_text(f"{HEADER}\n{row(1)}\n{row(2).replace('2,2', 'x,2', 1)}\n3,4\n")
    samples = GrowingFile.at(path, MEANING, None).read().samples
    assert np.isfinite(samples.tau).all(axis=1).tolist() == [True, False, False]


def test_files_of_a_folder_are_read_in_the_order_of_their_names(tmp_path):
    source = FillingFolder.at(tmp_path, MEANING, None)
    assert everything(source) == []
    (tmp_path / "b.csv").write_text(f"{HEADER}\n{row(1)}\n")
    assert everything(source) == [1.0]
    (tmp_path / "c.csv").write_text(f"{HEADER}\n{row(2)}\n")
    (tmp_path / "notes.md").write_text("no log")
    assert everything(source) == [2.0]
    (tmp_path / "a.csv").write_text(f"{HEADER}\n{row(0)}\n")
    batch = source.read()
    assert batch.samples is None
    assert "a.csv sorts before c.csv" in batch.notes[0]
    place = json.loads(json.dumps(source.position()))
    again = FillingFolder.at(tmp_path, MEANING, place)
    assert everything(again) == []
    with (tmp_path / "c.csv").open("a") as file:
        file.write(f"{row(3)}\n")
    assert everything(again) == [3.0]


@pytest.mark.parametrize("host", ["0.0.0.0:0", "192.168.0.1:0", "example.com:5"])
def test_no_other_machine_can_send(host):
    with pytest.raises(InputError, match="other machines"):
        LocalPort.at(host, MEANING)


def test_json_lines_come_over_a_port_of_this_machine():
    source = LocalPort.at("0", MEANING)
    try:
        with socket.create_connection(("127.0.0.1", source.port)) as sender:
            source.wait()
            assert "connected" in source.read().notes[0]
            first = json.dumps({"t": 1.0, "q": [0.1] * 6, "tau": [2.0] * 6}).encode()
            sender.sendall(first + b"\n" + first[:10])
            source.wait()
            assert source.read().samples.t.tolist() == [1.0]
        source.wait()
        assert "middle of a line" in source.read().notes[0]
    finally:
        source.close()


def test_a_line_of_numbers_is_no_line_of_names(tmp_path):
    path = tmp_path / "live.csv"
    path.write_text(f"{row(1)}\n{row(2)}\n")
    with pytest.raises(InputError, match="column names"):
        GrowingFile.at(path, MEANING, None).read()
