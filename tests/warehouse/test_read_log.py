"""Reading CSV and Parquet logs: what arrives, and what is said of bad ones."""

import tempfile
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from residual.errors import InputError
from residual.robot.robot import load_robot
from tests.residual.arms import arm
from tests.warehouse.conftest import NAMES
from warehouse.logs import ColumnMap, read_log
from warehouse.logs.column_map import CsvFormat, SignalMap, read_column_map
from warehouse.logs.log_reading import MemoryLog, read_opened_log
from warehouse.logs.log_window import find_interleaved_arms, find_leaps


def test_plain_csv_arrives_as_written(robot, samples, write):
    samples[:, 0] += 1000
    recording, understood = read_log(write(samples), robot)
    np.testing.assert_array_equal(recording.t, samples[:, 0])
    np.testing.assert_array_equal(recording.q, samples[:, 1:3])
    np.testing.assert_array_equal(recording.tau, samples[:, 3:])
    assert (recording.id, recording.robot) == ("run", "two_link")
    assert recording.qd is recording.qdd is recording.q_ref is None
    assert understood.text == "run: 400 samples, 100 Hz, 3.99 s; read t q1..2 tau1..2"


ENCODED = {
    **{f"separator {s!r}": (lambda x, s=s: x.replace(",", s).encode(), ()) for s in ";\t| "},
    "byte order mark, blanks, carriage returns, empty lines": (
        lambda x: x.replace(",", " , ").replace("\n", "\r\n\r\n").encode("utf-8-sig"),
        (),
    ),
    "latin 1": (
        lambda x: x.replace("\n", ",1\n").replace("2,1", "2,°C", 1).encode("latin-1"),
        ("°C",),
    ),
    "any order, a column of text": (
        lambda x: "\n".join(
            f"AUTO,{','.join(line.split(',')[::-1])}" for line in x.split()
        ).encode(),
        ("AUTO",),
    ),
}


@pytest.mark.parametrize(("encode", "ignored"), ENCODED.values(), ids=ENCODED)
def test_a_csv_of_another_form_has_the_same_samples(
    robot, samples, write, tmp_path, encode, ignored
):
    (tmp_path / "other.csv").write_bytes(encode(Path(write(samples)).read_text()))
    recording, understood = read_log(str(tmp_path / "other.csv"), robot)
    np.testing.assert_array_equal(recording.q, samples[:, 1:3])
    np.testing.assert_array_equal(recording.tau, samples[:, 3:])
    assert understood.ignored == ignored


def test_decimal_comma_and_skipped_lines_only_by_map(robot, samples, write, tmp_path):
    text = Path(write(samples, separator=";")).read_text().replace(".", ",")
    path = tmp_path / "german.csv"
    path.write_text("Regler 7\n\nAchsen 2\n" + text)
    csv = CsvFormat(decimal=",", skip=3)
    recording, _ = read_log(str(path), robot, ColumnMap(csv=csv))
    np.testing.assert_array_equal(recording.q, samples[:, 1:3])
    with pytest.raises(InputError, match=r"Decimal comma\?.*decimal = ','"):
        read_log(str(path), robot, ColumnMap(csv=CsvFormat(skip=3)))


def test_parquet_is_known_by_its_content(robot, samples, tmp_path):
    path = tmp_path / "run.log"
    columns = dict(zip(NAMES, samples.T, strict=True))
    columns["note"] = ["x"] * len(samples)
    pq.write_table(pa.table(columns), path)
    recording, understood = read_log(str(path), robot)
    np.testing.assert_array_equal(recording.tau, samples[:, 3:])
    assert understood.ignored == ("note",)


def test_optional_signals_are_read_if_whole_and_named_if_not(robot, samples, write):
    names = (*NAMES, "qd1", "qd2", "q_ref1", "q_out1", "temp")
    table = np.column_stack([samples, samples[:, :5]])
    recording, understood = read_log(write(table, names), robot)
    np.testing.assert_array_equal(recording.qd, samples[:, :2])
    assert recording.q_ref is None
    assert understood.ignored == ("q_ref1", "q_out1", "temp")
    assert understood.text.endswith("qd1..2; ignored q_ref1 q_out1 temp")


def test_a_channel_that_never_changes_and_a_gap_are_said(robot, samples, write):
    samples[:, 2] = 0.0
    samples[200:, 0] += 0.5
    warnings = read_log(write(samples), robot)[1].warnings
    assert "q2 never changes" in warnings[0]
    assert "1 gap(s) in time, the largest 0.51 s at t = 1.99 s" in warnings[1]


def change(row, column, value):
    def apply(table):
        table[row, column] = value
        return table

    return apply


def scale(columns, factor):
    def apply(table):
        table[:, columns] *= factor
        return table

    return apply


BAD_SAMPLES = {
    "nan": (change(range(7, 77), 2, np.nan), "q is NaN or infinite at sample 7"),
    "no number": (change(slice(None), 2, np.nan), r"at sample 0. Name a column"),
    "inf": (change(7, 4, np.inf), "tau is NaN or infinite at sample 7"),
    "huge": (change(7, 4, -1e300), "tau is -1e[+]300 at sample 7"),
    "time nan": (change(7, 0, np.nan), "time is NaN or infinite at sample 7"),
    "time backwards": (change(7, 0, 0.01), "time runs backwards at sample 7"),
    "time repeats": (change(7, 0, 0.06), "time repeats at sample 7"),
    "short": (lambda t: t[:150], "lasts 1.5 s, expected at least 2 s"),
    "one sample": (lambda t: t[:1], "has 1 samples"),
    "no samples": (lambda t: t[:0], "has 0 samples|no samples"),
    "slow": (scale(0, 1000), "Time in ms"),
    "microseconds": (scale(0, 1e6), "Time in us.*unit = 'us'"),
    "nanoseconds": (scale(0, 1e9), "Time in ns.*unit = 'us', scale = 1e-3"),
    "an hour": (lambda t: t + np.outer(t[:, 0] > 1, [3600, 0, 0, 0, 0]), "stops for 36"),
    "fast": (scale(0, 0.001), "is the unit of time right"),
    "still": (scale([1, 2], 0), "q is constant on all joints"),
    "no torque": (scale([3, 4], 0), "tau is constant on all joints"),
    "one torque frozen": (scale([4], 0), "tau is constant on joint 2"),
    "degrees": (scale([1, 2], 57.3), "range is -2 to 2 rad.\nDegrees?"),
    "zero moved": (lambda t: t + np.array([0, 2.5, 0, 0, 0]), "Check zero"),
}


@pytest.mark.parametrize(("spoil", "message"), BAD_SAMPLES.values(), ids=BAD_SAMPLES)
def test_bad_samples_are_refused(robot, samples, write, spoil, message):
    with pytest.raises(InputError, match=message) as caught:
        read_log(write(spoil(samples)), robot)
    assert str(caught.value).count("\n") <= 1


def test_a_few_missing_samples_are_masked_with_their_neighbours(robot, samples, write):
    samples[[7, 40], [2, 4]] = np.nan
    log, understood = read_log(write(samples), robot)
    assert len(log.t) == len(samples) - 2
    assert log.t[log.masked.any(axis=1)].tolist() == samples[[6, 8, 39, 41], 0].tolist()
    assert "2 samples are masked: not a number." in understood.doubts[0].words


def test_degrees_of_a_turning_joint_show_by_speed(make_robot, samples, write, tmp_path):
    make_robot()
    file = tmp_path / "arm" / "arm.urdf"
    file.write_text(file.read_text().replace('"revolute"', '"continuous"'))
    samples[:, 1:3] *= 57.3
    with pytest.raises(InputError, match=r"limit is 3 rad/s.\nDegrees"):
        read_log(write(samples), load_robot(file))


def test_a_broken_line_is_told_by_its_number(robot, samples, write, tmp_path):
    lines = Path(write(samples)).read_text().splitlines()
    path = tmp_path / "broken.csv"
    for broken, said in (
        (lines[41].replace(",", ",x", 1), "line 42: column 'q1' has 'x"),
        (lines[41] + ",7", "line 42 has 6 values for 5 names"),
    ):
        path.write_text("\n".join([*lines[:41], broken, *lines[42:]]))
        with pytest.raises(InputError, match=said):
            read_log(str(path), robot)


def test_a_line_of_names_that_was_cut_is_refused(robot, samples, write, tmp_path):
    text = Path(write(samples)).read_text()
    more = ",".join(f"signal_{i:010d}" for i in range(5000))
    path = tmp_path / "wide.csv"
    path.write_text(text.replace("\n", f",{more}\n", 1))
    with pytest.raises(InputError, match="line of column names is longer than"):
        read_log(str(path), robot)


BAD_NAMES = {
    "missing": (("t", "q1", "q2", "tau1", "x"), "missing column tau2 .*found t q1..2"),
    "missing two": (("t", "a", "b", "tau1", "tau2"), "missing column q1..2"),
    "near": (("T", "q1", "q2", "tau1", "tau_2"), r"missing column t tau2"),
    "no names": (("0", "1", "2.5", "3", "4e1"), "starts with numbers"),
    "twice": (("t", "q1", "q2", "tau2", "tau2"), "missing column tau1"),
}


@pytest.mark.parametrize(("names", "message"), BAD_NAMES.values(), ids=BAD_NAMES)
def test_bad_column_names_are_refused(robot, samples, write, names, message):
    with pytest.raises(InputError, match=message):
        read_log(write(samples, names), robot)


@pytest.mark.parametrize(
    ("extra", "message"),
    [
        ("q3", "'q3' is beyond the robot's joints 1 to 2"),
        ("tau7", "'tau7' is beyond"),
        ("qd0", "'qd0' is beyond"),
        ("q2", "'q2' appears twice"),
    ],
)
def test_joint_columns_that_misfit_are_refused(robot, samples, write, extra, message):
    table = np.column_stack([samples, samples[:, 1]])
    with pytest.raises(InputError, match=message):
        read_log(write(table, (*NAMES, extra)), robot)


def test_a_map_that_names_its_columns_reads_a_part_of_an_arm(robot, samples, write):
    names = ("t", "q2", "q3", "tau2", "tau3", "q1", "tau1", "qd1", "qd2", "qd3")
    table = np.column_stack([samples, *samples.T])
    q, tau = SignalMap(("q2", "q3"), "rad"), SignalMap(("tau2", "tau3"), "N m")
    named = ColumnMap(signals={"q": q, "tau": tau})
    log, understood = read_log(write(table, names), robot, named)
    np.testing.assert_array_equal(log.q, samples[:, 1:3])
    assert log.qd is None  # of other joints: those of the map need not be 1 and 2
    assert understood.ignored == names[5:]
    with pytest.raises(InputError, match="'tau3' is beyond"):
        read_log(write(table, names), robot, ColumnMap(signals={"q": q}))


def broken_parquet(samples):
    sink = pa.BufferOutputStream()
    pq.write_table(pa.table({"t": samples[:, 0]}), sink)
    return sink.getvalue().to_pybytes()[:-50]


BAD_FILES = {
    "no names": (
        lambda s: b"17,5,base,0.1,0.2,3,4\n17,9,base,0.2,0.3,3,4\n",
        "starts with numbers.*ros2 topic echo --csv",
    ),
    "empty": (lambda s: b"", "is empty"),
    "blank": (lambda s: b" \r\n\n", "is empty"),
    "rubbish": (lambda s: bytes(range(256)) * 40, "is binary but not Parquet"),
    "pickle": (lambda s: b"\x80\x04\x95\x00", "is binary"),
    "names only": (lambda s: b"t,q1,q2,tau1,tau2", "no samples|has 0 samples"),
    "text": (lambda s: b"t,q1,q2,tau1,tau2\n0,a,2,3,4\n", "'q1' has 'a', expected a"),
    "ragged": (lambda s: b"t,q1,q2,tau1,tau2\n0,1,2\n", "line 2 has 3 values for 5"),
    "parquet cut": (broken_parquet, "not a readable Parquet"),
    "parquet fake": (lambda s: b"PAR1 is text", "not a readable Parquet"),
    "prose": (lambda s: b"Dear reader,\nthis is a letter.\n", "missing column"),
}


@pytest.mark.parametrize(("content", "message"), BAD_FILES.values(), ids=BAD_FILES)
def test_bad_files_are_refused(robot, samples, tmp_path, content, message):
    (tmp_path / "run.csv").write_bytes(content(samples))
    with pytest.raises(InputError, match=message):
        read_log(str(tmp_path / "run.csv"), robot)


def test_text_column_in_parquet_is_refused(robot, samples, tmp_path):
    columns = dict(zip(NAMES, samples.T, strict=True))
    columns["q1"] = [str(x) for x in samples[:, 1]]
    pq.write_table(pa.table(columns), tmp_path / "run.parquet")
    with pytest.raises(InputError, match="'q1' holds string, expected numbers"):
        read_log(str(tmp_path / "run.parquet"), robot)


def test_of_two_parquet_columns_with_one_name_neither_is_read(robot, samples, tmp_path):
    names, path = [*NAMES, "note", "note"], tmp_path / "run.parquet"
    columns = [*samples.T, samples[:, 1], samples[:, 2]]
    pq.write_table(pa.table(columns, names=names), path)
    log, known = read_log(str(path), robot)
    np.testing.assert_array_equal(log.q, samples[:, 1:3])
    assert known.ignored == ("note", "note")
    pq.write_table(pa.table(columns, names=[*NAMES, "note", "q1"]), path)
    with pytest.raises(InputError, match="'q1' appears twice, expected once"):
        read_log(str(path), robot)


def test_a_clock_of_nanoseconds_and_long_lists_are_read_from_parquet(robot, samples, tmp_path):
    columns, path = dict(zip(NAMES, samples.T, strict=True)), tmp_path / "run.parquet"
    lists = samples[:, 1:3].tolist()
    columns["t"] = (samples[:, 0] * 1e9).astype("int64") + 1_760_000_000_123_456_789
    columns["q"] = pa.array(lists, pa.large_list(pa.float64()))
    q = SignalMap(("q[0]", "q[1]"), "rad")
    written = ColumnMap(time="t", time_scale=1e-9, signals={"q": q})
    pq.write_table(pa.table(columns), path)
    log, _ = read_log(str(path), robot, written)
    np.testing.assert_array_equal(log.q, samples[:, 1:3])
    np.testing.assert_allclose(log.t - log.t[0], samples[:, 0] - samples[0, 0], atol=1e-6)
    columns["q"] = pa.array([*lists[:-1], [1.0]])
    pq.write_table(pa.table(columns), path)
    with pytest.raises(InputError, match="lists of column 'q' differ in length"):
        read_log(str(path), robot, written)


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("none.csv", "No log file 'none.csv'"),
        (".", "is a folder"),
        ("/dev/null", "not a regular file"),
    ],
)
def test_what_is_not_a_file_is_refused(robot, tmp_path, monkeypatch, spec, message):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=message):
        read_log(spec, robot)


@pytest.mark.parametrize("again", [lambda t: np.repeat(t, 2, 0), lambda t: [*t, *t]])
def test_rows_that_stand_twice_are_read_once(samples, write, make_robot, again):
    log, known = read_log(write(np.array(again(samples))), make_robot())
    np.testing.assert_array_equal(log.t, samples[:, 0])
    np.testing.assert_array_equal(log.tau, samples[:, 3:])
    assert any(f"{len(samples)} rows are duplicates" in n for n in known.notes)


@pytest.mark.parametrize(
    ("every", "apart", "sign", "off"),
    [
        *((every, apart, -1, -0.3) for every in (1, 4) for apart in (0.0, 0.004)),
        (1, 0.005, 1, 0.06),  # two that stand alike and take turns
        (1, 0.005, 1, 0.2),
    ],
)
def test_two_arms_in_a_log_are_refused(samples, write, make_robot, every, apart, sign, off):
    other = samples[::every].copy()
    other[:, 0] += apart
    other[:, 1:3] = sign * other[:, 1:3] + off
    both = np.concatenate([samples, other])
    both = both[np.argsort(both[:, 0], kind="stable")]
    with pytest.raises(InputError, match="interleaved"):
        read_log(write(both), make_robot())


@pytest.mark.parametrize("noise", [0.0, 1e-3, 0.05])
def test_noise_of_an_encoder_is_no_second_arm(samples, write, make_robot, noise):
    rng = np.random.default_rng(3)
    samples[:, 1:3] += noise * rng.normal(size=(len(samples), 2))
    log, _ = read_log(write(samples), make_robot())
    assert len(log.t) == len(samples)


def test_a_false_reading_that_is_repeated_is_a_leap_there_and_back():
    q = np.linspace(0, 5, 600)[:, None]
    q[20:22] += 3.5
    q[40] -= 1.0
    assert np.flatnonzero(find_leaps(q)).tolist() == [20, 21, 40]
    q[20:26] += 3.5  # no false reading lasts so long
    assert 25 not in np.flatnonzero(find_leaps(q))


DRIVEN = "drive = {gain = [2.0, 3.0], limit = [1.0, 9.0], enabled = 'on'}\n"


def driven_log(change=lambda table: None):
    """A log of two joints with goals and no torque, through a map."""
    t = np.arange(0, 4, 0.01)
    q = np.column_stack([np.sin(t), np.cos(2 * t)])
    table = {"t": t, "q1": q[:, 0], "q2": q[:, 1], "on": (t < 3).astype(float)}
    table |= {"q_ref1": q[:, 0] + 0.4, "q_ref2": q[:, 1] + 0.1 * t}
    change(table)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "map.toml"
        path.write_text(DRIVEN)
        columns = read_column_map(path)
    return read_opened_log(MemoryLog(table, "log"), arm(), columns, "log", "log")


def test_a_drive_of_the_map_gives_torque_where_the_log_has_none():
    log, understood = driven_log()
    assert (log.tau[log.t >= 3] == 0).all()
    np.testing.assert_allclose(log.tau[log.t < 3], [2.0, 3.0] * (log.q_ref - log.q)[:300])
    assert not log.masked.any()
    assert "on" in understood.used
    assert log.drive.limit == (1.0, 9.0)


def test_a_lost_or_leaping_sample_of_a_drive_is_masked_and_the_log_is_read():
    def spoil(table):
        table["q1"][50:52] += 3.0
        table["q_ref2"][120] = np.nan

    log, understood = driven_log(spoil)
    assert len(log.t) == 397
    assert not {0.5, 0.51, 1.2} & set(log.t.round(3))
    at = log.t[log.masked.any(axis=1)].round(3)
    np.testing.assert_array_equal(at, [0.49, 0.52, 1.19, 1.21])
    assert [d.certain for d in understood.doubts] == [False]
    assert "3 samples are masked" in understood.doubts[0].words


def test_a_drive_at_its_limit_or_beyond_the_range_is_masked():
    def pull(table):
        table["q_ref1"][100:200] = table["q1"][100:200] + 0.6  # 1.2 N m of 1
        table["q_ref2"][250:260] = 9.0  # rad

    log, _ = driven_log(pull)
    assert log.masked[100:200, 0].all()
    assert log.masked[250:260, 1].all()
    assert log.masked.sum() == 110


def test_a_drive_needs_the_goal_and_a_value_for_each_joint():
    with pytest.raises(InputError, match="missing column q_ref1"):
        driven_log(lambda table: table.pop("q_ref1"))


def test_angles_over_a_gap_in_time_are_no_second_arm():
    t = np.arange(0, 8, 0.01)
    keep = np.abs(np.sin(3 * t)) > 0.3  # rows at the middle are left out
    q = np.sin(3 * t[keep])[:, None]
    assert find_interleaved_arms(q, "log", t[keep]) is None
