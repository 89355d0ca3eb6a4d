"""COLUMNS.toml: units, sides, signs; and what is said of a bad one."""

import numpy as np
import pytest

from residual.errors import InputError
from warehouse.logs import read_column_map, read_log

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
        "q: deg to rad, sign turned on joint 2, times 0.25, 2, zero moved",
        "tau: sign turned on joint 2, times 0.001, 0.002",
    )
    done = {channel: told for channel, _, _, told in understood.channels}
    assert done["t"] == "times 0.5"
    assert done["tau2"] == "sign turned, times 0.002"


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
        "only a position has its own",
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
        (BASE + Q + 'tau = {columns = ["J1", "I2"]}', "'J1' stands twice"),
        (MOTOR, "needs gear_ratio"),
        (CURRENT.replace("SIDE", "link"), "needs torque_per_unit"),
    ],
)
def test_maps_that_do_not_fit_the_log_or_the_robot_are_refused(read, text, message):
    with pytest.raises(InputError, match=message):
        read(text)
