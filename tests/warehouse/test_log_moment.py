"""When a log was recorded: what it says itself, and nothing that is guessed."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from residual.errors import InputError
from tests.warehouse import log_files as files
from warehouse.logs import read_log
from warehouse.logs.file import iso, parse

NAMES = ("t", "q1", "q2", "tau1", "tau2")
START = 1_763_647_380  # 2025-11-20 14:03:00 UTC


def when(path, robot):
    return iso(read_log(str(path), robot)[1].recorded_at)


def above(path, line):
    path.write_text(f"{line}\n" + path.read_text())
    return path


@pytest.fixture
def log(samples, write, tmp_path):
    write(samples)
    return tmp_path / "run.csv"


def test_a_log_that_says_no_time_has_none(log, robot):
    assert when(log, robot) is None


def test_a_line_above_the_table_says_when(log, robot):
    above(log, "Recorded 2025-11-20T15:03:00+01:00 by R. Studio")
    assert when(log, robot) == "2025-11-20T14:03:00Z"
    assert when(f"{log}@1:", robot) == "2025-11-20T14:03:01Z"


def test_a_time_without_a_zone_is_told_and_not_used(log, robot):
    _, known = read_log(str(above(log, "Date: 2025-11-20 15:03:00")), robot)
    assert known.recorded_at is None
    assert "2025-11-20 15:03:00 has no time zone" in known.text


def test_a_clock_of_seconds_since_1970_says_when(samples, write, robot):
    samples[:, 0] += START
    assert when(write(samples), robot) == "2025-11-20T14:03:00Z"
    # From being turned on: no date.
    samples[:, 0] -= START - 1000
    assert when(write(samples), robot) is None


def test_metadata_of_parquet_say_when(samples, robot, tmp_path):
    table = pa.table(dict(zip(NAMES, samples.T, strict=True)))
    told = table.replace_schema_metadata({"recorded_at": "2025-11-20T14:03:00Z"})
    pq.write_table(told, tmp_path / "run.parquet")
    assert when(tmp_path / "run.parquet", robot) == "2025-11-20T14:03:00Z"


def test_a_bag_says_when_its_first_message_was_recorded(samples, robot, tmp_path):
    names = list(robot.model.names)[1:]
    stamps = {"/js": files.messages(samples, names, START)}
    files.write_mcap(tmp_path / "run.mcap", stamps)
    assert when(tmp_path / "run.mcap", robot).startswith("2025-11-20T14:03:00.00")
    np.testing.assert_equal(when(tmp_path / "run.mcap", robot)[-1], "Z")


@pytest.mark.parametrize(
    "text", ["", "2025", "2025-11-20T14:03:00", "1970-01-01T00:00Z"]
)
def test_a_time_that_is_given_has_a_zone_and_is_possible(text):
    with pytest.raises(InputError, match="expected a date with time and zone"):
        parse(text, "--recorded-at")
