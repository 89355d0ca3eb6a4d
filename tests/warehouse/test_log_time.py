"""When a log was recorded, windows of it, and that no sample counts twice."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from residual.errors import InputError
from residual.recording import Recording
from tests.warehouse import log_files as files
from warehouse.logs import check_logs_distinct, read_log
from warehouse.logs.log_tables import format_timestamp, parse_timestamp

NAMES = ("t", "q1", "q2", "tau1", "tau2")
START = 1_763_647_380  # 2025-11-20 14:03:00 UTC


def when(path, robot):
    return format_timestamp(read_log(str(path), robot)[1].recorded_at)


LINES = {
    "": (None, ""),
    "Recorded 2025-11-20T15:03:00+01:00 by R. Studio\n": ("2025-11-20T14:03:00Z", ""),
    "Date: 2025-11-20 15:03:00\n": (None, "2025-11-20 15:03:00 has no time zone"),
}


@pytest.mark.parametrize("line", LINES)
def test_a_line_above_the_table_says_when(samples, write, robot, line):
    path = Path(write(samples))
    path.write_text(line + path.read_text())
    moment, words = LINES[line]
    assert when(path, robot) == moment
    assert words in read_log(str(path), robot)[1].text
    later = moment and moment.replace("00Z", "01Z")
    assert when(f"{path}@1:", robot) == later


def test_a_clock_of_seconds_since_1970_says_when(samples, write, robot):
    samples[:, 0] += START
    assert when(write(samples), robot) == "2025-11-20T14:03:00Z"
    # From being turned on: no date.
    samples[:, 0] -= START - 1000
    assert when(write(samples), robot) is None


def test_metadata_of_parquet_say_when(samples, robot, tmp_path):
    table = pa.table(dict(zip(NAMES, samples.T, strict=True)))
    dated = table.replace_schema_metadata({"recorded_at": "2025-11-20T14:03:00Z"})
    pq.write_table(dated, tmp_path / "run.parquet")
    assert when(tmp_path / "run.parquet", robot) == "2025-11-20T14:03:00Z"


def test_a_bag_says_when_its_first_message_was_recorded(samples, robot, tmp_path):
    stamps = {"/js": files.messages(samples, list(robot.model.names)[1:], START)}
    files.write_mcap(tmp_path / "run.mcap", stamps)
    assert when(tmp_path / "run.mcap", robot).startswith("2025-11-20T14:03:00.00")


@pytest.mark.parametrize("text", ["", "2025", "2025-11-20T14:03:00", "1970-01-01T00:00Z"])
def test_a_time_that_is_given_has_a_zone_and_is_possible(text):
    with pytest.raises(InputError, match="expected a date with time and zone"):
        parse_timestamp(text)


@pytest.mark.parametrize(
    ("window", "first", "last"),
    [
        ("0:2.5", 0, 249),
        ("1:", 100, 399),
        (":3", 0, 299),
        ("1.5:4", 150, 399),
        ("40%:", 160, 399),
        (":60%", 0, 239),
        ("0%:100%", 0, 399),
        ("1:75%", 100, 299),
    ],
)
def test_window_is_closed_at_its_start_and_open_at_its_end(
    robot, samples, write, window, first, last
):
    samples[:, 0] += 17
    recording, understood = read_log(f"{write(samples)}@{window}", robot)
    np.testing.assert_array_equal(recording.t, samples[first : last + 1, 0])
    assert recording.id == f"run@{window}"
    assert understood.window == window


@pytest.mark.parametrize("cut", ["50%", "2", "3.9999", "2.003", "57%", "2.0099999"])
def test_two_halves_share_no_sample_and_lose_none(robot, samples, write, cut):
    path = write(np.vstack([samples, samples + np.array([4, 0, 0, 0, 0])]))
    rows = [read_log(f"{path}@{w}", robot)[1].rows for w in (f":{cut}", f"{cut}:")]
    assert sum(rows) == 800


@pytest.mark.parametrize(
    ("window", "message"),
    [
        ("0:5", "outside the log, which lasts 4 s"),
        ("4:", "outside the log"),
        ("9:12", "outside the log"),
        ("101%:", "101% is outside"),
        ("3:2.5", "is empty"),
        ("2:2", "is empty"),
        ("1", "not understood, expected @start:end"),
        ("-1:2", "not understood"),
        ("a:b", "not understood"),
        ("", "not understood"),
        ("0:1", "expected at least 2 s"),
        ("1:1.005", "1 samples"),
    ],
)
def test_bad_windows_are_refused(robot, samples, write, window, message):
    with pytest.raises(InputError, match=message):
        read_log(f"{write(samples)}@{window}", robot)


def recording(label, table):
    t, q, tau = table[:, 0], table[:, 1:3], table[:, 3:]
    return Recording(id=label, robot="two_link", t=t, q=q, tau=tau)


def test_windows_that_touch_are_distinct_and_those_that_overlap_are_not(robot, samples, write):
    path = write(samples)
    first, second = (read_log(f"{path}@{w}", robot)[0] for w in (":2", "2:"))
    check_logs_distinct([first, second])
    early = read_log(f"{path}@1.9:", robot)[0]
    with pytest.raises(InputError, match=r"'run@:2' and 'run@1.9:' hold the same"):
        check_logs_distinct([second, first, early][1:])


def test_a_copy_on_another_clock_is_found(samples):
    copy = samples.copy()
    copy[:, 0] += 100
    with pytest.raises(InputError, match=r"same samples \(about 400\)"):
        check_logs_distinct([recording("a", samples), recording("b", copy)])


def test_the_same_rest_position_is_no_copy(samples):
    """Coarse sensors give the same samples in any two logs while the arm rests."""
    other = samples.copy()
    other[:, 1:] += 0.5
    rest = np.tile([0, 0.1, 0.2, 1.0, 2.0], (300, 1))
    rest[150:, 3] = 1.5
    rest[:, 0] = np.arange(300) / 100
    logs = [
        recording(label, np.vstack([rest, table + np.array([3, 0, 0, 0, 0])]))
        for label, table in (("a", samples), ("b", other))
    ]
    check_logs_distinct(logs)


def test_two_runs_of_one_seed_differ_once_the_arm_moves(samples):
    """A plant's seed draws the same noise at standstill, whatever is hidden in it."""
    rng = np.random.default_rng(0)
    still = np.array([0, 0.1, 0.2, 1.0, 2.0]) + 1e-4 * rng.normal(size=(166, 5))
    still[:, 0] = np.arange(166) / 100
    moving = samples + np.array([1.66, 0, 0, 0, 0])
    moving[:, 1:3] += still[-1, 1:3] - moving[0, 1:3]
    stronger = moving.copy()
    stronger[:, 3] *= 1.3
    check_logs_distinct(
        [recording(n, np.vstack([still, m])) for n, m in (("a", moving), ("b", stronger))]
    )
    with pytest.raises(InputError, match="hold the same samples"):
        check_logs_distinct([recording(n, np.vstack([still, moving])) for n in "ab"])
