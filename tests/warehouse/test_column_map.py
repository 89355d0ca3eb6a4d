"""COLUMNS.toml, windows and times of logs; and what is said of bad ones."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from residual.errors import InputError
from residual.recording import Recording
from tests.warehouse import log_files as files
from tests.warehouse.conftest import NAMES
from warehouse.logs import check_logs_distinct, read_column_map, read_log
from warehouse.logs.log_tables import format_timestamp, parse_timestamp

LOG_NAMES = ("Time", "J1", "J2", "I1", "I2")


@pytest.fixture
def read(samples, write, tmp_path, make_robot):
    """Return a function that reads the log of LOG_NAMES by a map's text."""

    def read(text, table=None, robot_toml=""):
        (tmp_path / "COLUMNS.toml").write_text(text)
        columns = read_column_map(tmp_path / "COLUMNS.toml")
        path = write(samples if table is None else table, LOG_NAMES)
        return read_log(path, make_robot(robot_toml), columns)

    return read


BASE = 'time = {column = "Time"}\n'
Q = 'q = {columns = ["J1", "J2"]}\n'


def test_scales_are_applied_after_unit_and_sign_and_said(read, samples):
    table = samples * [2, 1, 1, 1000, -500]
    table[:, 1:3] = np.rad2deg(samples[:, 1:3]) * [4, -0.5] + [10, -20]
    recording, understood = read(
        'time = {column = "Time", scale = 0.5}\n'
        'q = {columns = ["J1", "J2"], unit = "deg", sign = [1, -1], zero = [10, -20], '
        "scale = [0.25, 2]}\n"
        'tau = {columns = ["I1", "I2"], sign = [1, -1], scale = [1e-3, 2e-3]}\n',
        table,
    )
    np.testing.assert_allclose(recording.t, samples[:, 0])
    np.testing.assert_allclose(recording.q, samples[:, 1:3], atol=1e-12)
    np.testing.assert_allclose(recording.tau, samples[:, 3:])
    assert understood.conversions == (
        "t: times 0.5",
        "q: deg to rad, sign reversed on joint 2, times 0.25, 2, zero shifted",
        "tau: sign reversed on joint 2, times 0.001, 0.002",
    )
    done = {channel: told for channel, _, _, told in understood.channels}
    assert done["t"] == "times 0.5"
    assert done["tau2"] == "sign reversed, times 0.002"


MOTOR = (
    BASE
    + 'q = {columns = ["J1", "J2"], side = "motor"}\n'
    + 'tau = {columns = ["I1", "I2"], side = "motor"}\n'
)


def test_gears_turn_motor_angles_and_torques_into_those_of_the_link(read, samples):
    table = samples * [1, 100, -50, 1 / 100, -1 / 50]
    recording, _ = read(MOTOR, table, "[joints]\ngear_ratio = [100, -50]")
    np.testing.assert_allclose(recording.q, samples[:, 1:3])
    np.testing.assert_allclose(recording.tau, samples[:, 3:])


def test_couplings_keep_the_power_of_both_sides(read, samples):
    coupling = np.array([[100.0, 0.0], [-3.0, 50.0]])
    table = samples.copy()
    table[:, 1:3] = samples[:, 1:3] @ coupling.T
    log, _ = read(MOTOR, table, "[couplings]\nmotor_from_joint = [[100, 0], [-3, 50]]")
    np.testing.assert_allclose(log.q, samples[:, 1:3], atol=1e-12)
    np.testing.assert_allclose(
        np.sum(log.tau * log.q, axis=1), np.sum(table[:, 3:] * table[:, 1:3], axis=1)
    )


CURRENT = BASE + Q + 'tau = {columns = ["I1", "I2"], unit = "A", side = "SIDE"}'


@pytest.mark.parametrize("side", ["link", "motor"])
def test_torque_per_unit_holds_at_the_link_whatever_the_side(read, samples, side):
    recording, understood = read(
        CURRENT.replace("SIDE", side), None, "[joints]\ntorque_per_unit = [30, -20]"
    )
    np.testing.assert_allclose(recording.tau, samples[:, 3:] * [30, -20])
    assert "A to N m" in understood.conversions[0]


def test_currents_of_coupled_motors_act_on_both_joints(read, samples):
    toml = (
        "[joints]\ntorque_per_unit = [30, 20]\n[couplings]\nmotor_from_joint = [[100, 0], [-5, 50]]"
    )
    recording, _ = read(CURRENT.replace("SIDE", "motor"), None, toml)
    motor = samples[:, 3:] * [30 / 100, 20 / 50]
    np.testing.assert_allclose(recording.tau[:, 0], motor @ [100, -5])
    np.testing.assert_allclose(recording.tau[:, 1], motor @ [0, 50])


BAD_MAPS = {
    "not toml": ("time =", "not valid TOML"),
    "key": ("tim = {}", "did you mean 'time'"),
    "inner key": ("time = {colum = 't'}", "did you mean 'column'"),
    "no table": ("time = 't'", "time is 't', expected a table"),
    "name": ("time = {column = 3}", r"\[time\] column is 3, expected text in quotes"),
    "time unit": ("time = {unit = 'min'}", "Valid: ms, s, us"),
    "unit": ("q = {columns = ['a', 'b'], unit = 'degrees'}", "did you mean 'deg'"),
    "side": ("q = {columns = ['a', 'b'], side = 'moter'}", "did you mean 'motor'"),
    "no columns": ("q = {unit = 'deg'}", r"\[q\] needs the key 'columns'"),
    "sign": ("q = {columns = ['a', 'b'], sign = [1, 2]}", "list of 1 and -1"),
    "sign length": ("q = {columns = ['a', 'b'], sign = [1]}", "1 entries for 2"),
    "scale": ("q = {columns = ['a', 'b'], scale = [1, 0]}", "list of positive numbers"),
    "scale sign": ("q = {columns = ['a', 'b'], scale = [1, -1]}", "see sign"),
    "scale length": ("q = {columns = ['a', 'b'], scale = [1]}", "1 entries for 2"),
    "one scale": ("q = {columns = ['a', 'b'], scale = 2.0}", "expected a list"),
    "scale text": (
        "tau = {columns = ['a', 'b'], scale = [1, '2']}",
        r"scale \(entry 2\) is '2', expected a number",
    ),
    "scale infinite": (
        "tau = {columns = ['a', 'b'], scale = [1, inf]}",
        r"scale \(entry 2\) is inf, expected a finite number",
    ),
    "time scale": ("time = {scale = 0.0}", "scale is 0.0, expected greater than 0"),
    "time scales": ("time = {scale = [1]}", r"scale is \[1\], expected a number"),
    "time scale true": ("time = {scale = true}", "scale is True, expected a number"),
    "time scale nan": ("time = {scale = nan}", "scale is nan"),
    "zero": (
        "q = {columns = ['a', 'b'], zero = [nan, 0]}",
        r"zero \(entry 1\) is nan, expected a finite number",
    ),
    "zero of torque": (
        "tau = {columns = ['a', 'b'], zero = [0, 0]}",
        "only a position can have one",
    ),
    "separator": ("csv = {separator = ';;'}", "one character"),
    "both": ("csv = {separator = ',', decimal = ','}", "both ','"),
    "decimal": ("csv = {decimal = ';'}", "Unknown decimal"),
    "skip": ("csv = {skip = -1}", r"\[csv\] skip is -1, expected greater than or equal to 0"),
}


@pytest.mark.parametrize(("text", "message"), BAD_MAPS.values(), ids=BAD_MAPS)
def test_bad_maps_are_refused(tmp_path, text, message):
    (tmp_path / "c.toml").write_text(text)
    with pytest.raises(InputError, match=message):
        read_column_map(tmp_path / "c.toml")


def test_a_map_that_is_not_there_is_named(tmp_path):
    with pytest.raises(InputError, match=r"Cannot read .*none.toml: No such file"):
        read_column_map(tmp_path / "none.toml")
    (tmp_path / "model.json").write_text("{}")
    with pytest.raises(InputError, match=r"TOML.*\nA map is a TOML file; modelgap map"):
        read_column_map(tmp_path / "model.json")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            BASE + Q + 'tau = {columns = ["I1"]}',
            r"names 1 columns of tau.*, .*\)\. Name one column per joint .* --chain",
        ),
        (BASE + Q + 'tau = {columns = ["I1", "I3"]}', "missing column I3"),
        (BASE + Q + 'tau = {columns = ["J1", "I2"]}', "'J1' appears twice"),
        (MOTOR, "needs gear_ratio"),
        (CURRENT.replace("SIDE", "link"), "needs torque_per_unit"),
    ],
)
def test_maps_that_do_not_fit_the_log_or_the_robot_are_refused(read, text, message):
    with pytest.raises(InputError, match=message):
        read(text)


# When a log was recorded, windows of it, and that no sample counts twice.


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
