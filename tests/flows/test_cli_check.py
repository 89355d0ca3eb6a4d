"""modelgap check: what it says, and the lines that mend a log."""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest

from flows.cli import main
from flows.steps import check as steps
from flows.steps.check import format_gravity_line, format_repair_lines
from residual.check.result import Fault, LogCheck, Repair, read_log_check
from residual.errors import InputError
from residual.robot.robot import load_robot
from tests.warehouse.conftest import chain
from warehouse.logs import ColumnMap, read_column_map, read_log

HIDDEN = Path(__file__).parents[2] / "examples" / "hidden"


def run(words):
    return main(words.split())


@pytest.fixture
def log(tmp_path, monkeypatch):
    """Return a function that writes a spoiled copy of an example; it is A.csv."""
    monkeypatch.chdir(tmp_path)
    table = np.genfromtxt(HIDDEN / "fit_3.csv", delimiter=",", names=True)[:1500]

    def write(spoil=lambda table: None, name="A"):
        own = table.copy()
        spoil(own)
        np.savetxt(
            f"{name}.csv",
            np.array(own.tolist()),
            delimiter=",",
            header=",".join(own.dtype.names),
            comments="",
        )

    return write


@pytest.fixture
def fake_check(monkeypatch):
    """Replace the core of the check; returns a function that says what it finds."""

    def set(*faults):
        monkeypatch.setattr(steps, "check_logs", lambda *_: LogCheck(tuple(faults)))

    set()
    return set


SIGN = Fault(
    "torque_sign",
    (2,),
    True,
    "Friction of joint 2 is negative.",
    (Repair("tau", (2,), sign=(-1,)),),
)
LATE = Fault("delay", (), False, "Torque is late by 8 ms.", (), "A")


def test_the_json_is_whole_and_alone_on_standard_output(log, fake_check, capsys):
    log()
    fake_check(SIGN, LATE)
    assert run("check A.csv --robot irb140 --json -") == 0
    document = json.loads(capsys.readouterr().out)
    assert document["schema"] == 1
    assert document["verdict"] == "unusable"
    sign, late = document["faults"]
    assert (sign["kind"], sign["joints"], sign["certain"]) == ("torque_sign", [2], True)
    assert sign["repair"][0].startswith("tau = {columns = [")
    assert late == {
        "kind": "delay",
        "joints": [],
        "certain": False,
        "evidence": "A: Torque is late by 8 ms.",
        "repair": [],
        "rivals": [],
        "settle": "",
    }
    assert read_log_check(document).to_json() == document


def spoil(column, rows, value):
    def apply(table):
        table[column][rows] = value

    return apply


UNREADABLE = {
    "nan": (spoil("q2", slice(7, 507), np.nan), ("spike", [2])),
    "infinite": (spoil("tau3", 7, np.inf), ("spike", [3])),
    "clock back": (spoil("t", 9, 0.0), ("clock", [])),
    "clock stands": (spoil("t", slice(9, 12), 1.0), ("clock", [])),
    "clock nan": (spoil("t", 9, np.nan), ("clock", [])),
    "torque frozen": (spoil("tau2", slice(None), 1.0), ("frozen", [2])),
    "nothing moves": (
        lambda table: [spoil(f"q{i}", slice(None), 0.1)(table) for i in range(1, 7)],
        ("frozen", []),
    ),
    "degrees": (
        lambda table: [table[f"q{i}"].__imul__(57.3) for i in range(1, 7)],
        ("angle_unit", []),
    ),
    "outside": (lambda table: table["q2"].__iadd__(3), ("out_of_range", [2])),
    "micro": (lambda table: table["t"].__imul__(1e-3), ("too_short", [])),
    "milli": (lambda table: table["t"].__imul__(1e3), ("time_unit", [])),
}


@pytest.mark.parametrize(("spoiled", "fault"), UNREADABLE.values(), ids=UNREADABLE)
def test_what_other_commands_refuse_to_read_is_a_fault_here(
    log, fake_check, capsys, spoiled, fault
):
    log(spoiled)
    assert run("check A.csv --robot irb140 --json -") == 0
    document = json.loads(capsys.readouterr().out)
    assert document["verdict"] == "unusable"
    assert fault in [(f["kind"], f["joints"]) for f in document["faults"]]


@pytest.mark.parametrize(("column", "size"), [("q2", 1e300), ("q2", -1.7e308), ("tau3", 1e308)])
def test_a_huge_sample_is_a_fault_and_no_failure(log, capsys, column, size):
    log(spoil(column, 700, size))
    assert run("check A.csv --robot irb140 --json -") == 0
    (fault,) = json.loads(capsys.readouterr().out)["faults"]
    assert (fault["kind"], fault["joints"]) == ("spike", [int(column[-1])])
    assert fault["certain"]
    assert f"{size:.3g} at sample 700" in fault["evidence"]


@pytest.mark.parametrize("document", [{}, {"schema": 2}, {"schema": 1, "faults": [{}]}])
def test_a_document_that_is_no_check_is_refused(document):
    with pytest.raises(InputError, match="check"):
        read_log_check(document)


ROBOT_FILE = """<robot name="two"><link name="b"/>
<link name="u"><inertial><origin xyz="0 0 0.2"/><mass value="1.6"/>
  <inertia ixx="0.05" iyy="0.05" izz="0.4" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="w"><inertial><origin xyz="0 0 0.12"/><mass value="0.7"/>
  <inertia ixx="0.004" iyy="0.004" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial>
</link>
<joint name="shoulder" type="revolute"><parent link="b"/><child link="u"/>
  <axis xyz="0 1 0"/><limit lower="-2" upper="2" velocity="5" effort="60"/></joint>
<joint name="elbow" type="revolute"><parent link="u"/><child link="w"/>
  <origin xyz="0 0 0.35"/><axis xyz="0 1 0"/>
  <limit lower="-2" upper="2" velocity="5" effort="0.1"/></joint></robot>"""


def test_without_a_log_the_robot_file_is_told(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("arm.urdf").write_text(ROBOT_FILE)
    assert run("check --robot arm.urdf --json arm.json") == 0
    said = capsys.readouterr().out
    assert "The robot file is implausible in 2 points." in said
    assert "Link 'u': tensor ixx 0.05, iyy 0.05, izz 0.4 kg m^2: the moment" in said
    assert "torque limit is 0.1 N m, and the weight of the arm alone takes" in said
    assert "    w (joint 2: elbow)" in said
    document = json.loads(Path("arm.json").read_text())
    assert [(f["joints"], f["certain"]) for f in document["faults"]] == [([1], False), ([2], False)]
    assert [body["flaw"] for body in document["robot"]["bodies"]] == ["impossible", None]
    assert run("check --robot irb140") == 0
    assert "Nothing in the robot file is implausible." in capsys.readouterr().out


# The lines that mend a log: valid maps, and a log read with them is the right one.


RIGHT = [3, 1, 2]
NAMES = ("t", *(f"{s}{i}" for s in ("q", "qd", "tau") for i in (1, 2, 3)))


@pytest.fixture
def arm(tmp_path):
    def load(toml=""):
        folder = tmp_path / "arm"
        folder.mkdir(exist_ok=True)
        (folder / "arm.urdf").write_text(chain("three", 3))
        (folder / "robot.toml").write_text(toml)
        return load_robot(folder)

    return load


@pytest.fixture
def table():
    """Ten seconds at 50 Hz: t, q, qd, tau."""
    t = np.arange(500) / 50
    rates, phases = np.array([1.0, 1.3, 1.7]), np.array([0.0, 0.4, 0.9])
    angle = np.outer(t, rates) + phases
    torque = np.random.default_rng(3).normal(size=(500, 3))
    return np.column_stack([t, np.sin(angle), rates * np.cos(angle), torque])


def columns_of(text, folder):
    (folder / "map.toml").write_text(text)
    return read_column_map(folder / "map.toml")


def read(table, robot, columns, folder):
    np.savetxt(folder / "log.csv", table, delimiter=",", header=",".join(NAMES), comments="")
    return read_log(str(folder / "log.csv"), robot, columns, despite_doubts=True)[0]


# By name: how the table is spoiled, what mends it, and the line.
FAULTS = {
    "torque sign": (
        lambda t: t * np.array([1, *(1,) * 6, 1, -1, 1]),
        [Repair("tau", (2,), sign=(-1,))],
        'tau = {columns = ["tau1", "tau2", "tau3"], sign = [1, -1, 1]}',
    ),
    "order and sign": (
        lambda t: t[:, [0, 1, 2, 3, 4, 5, 6, 7, 9, 8]] * np.array([1] * 9 + [-1]),
        [Repair("tau", (2, 3), order=(1, 3, 2), sign=(-1, 1))],
        'tau = {columns = ["tau1", "tau3", "tau2"], sign = [1, -1, 1]}',
    ),
    "a ring of three": (
        lambda t: t[:, [0, *RIGHT, 4, 5, 6, 7, 8, 9]],
        [Repair("q", (1, 2, 3), order=(2, 3, 1))],
        'q = {columns = ["q2", "q3", "q1"]}',
    ),
    "N mm": (
        lambda t: t * np.array([1] * 7 + [1000] * 3),
        [Repair("tau", scale=1e-3)],
        'tau = {columns = ["tau1", "tau2", "tau3"], unit = "N mm"}',
    ),
    "degrees": (
        lambda t: t * np.array([1] + [180 / np.pi] * 6 + [1] * 3),
        [Repair("q", scale=np.pi / 180), Repair("qd", scale=np.pi / 180)],
        'q = {columns = ["q1", "q2", "q3"], unit = "deg"}\n'
        'qd = {columns = ["qd1", "qd2", "qd3"], unit = "deg/s"}',
    ),
    "milliseconds": (
        lambda t: t * np.array([1000] + [1] * 9),
        [Repair("t", scale=1e-3)],
        'time = {column = "t", unit = "ms"}',
    ),
}


@pytest.mark.parametrize(("spoil", "repairs", "line"), FAULTS.values(), ids=FAULTS)
def test_a_log_that_is_read_with_the_line_is_the_right_one(
    arm, table, tmp_path, spoil, repairs, line
):
    robot = arm()
    right = read(table, robot, ColumnMap(), tmp_path)
    lines = format_repair_lines(repairs, robot, ColumnMap())
    assert lines == line
    assert_same(read(spoil(table), robot, columns_of(lines, tmp_path), tmp_path), right)


def assert_same(one, other):
    for name in ("t", "q", "qd", "tau"):
        pair = (getattr(one, name), getattr(other, name))
        np.testing.assert_allclose(*pair, rtol=1e-8, atol=1e-12, err_msg=name)


GEARS = "[joints]\ngear_ratio = [100, -50, 80]\ntorque_per_unit = [30, -20, 10]"
MAPS = {
    "zero and sign": (
        'q = {columns = ["q1", "q2", "q3"], sign = [1, -1, 1], zero = [0.1, 0, -0.2]}',
        ("q", 1),
    ),
    "motor side": ('q = {columns = ["q1", "q2", "q3"], side = "motor"}', ("q", 1)),
    "motor torque": (
        'tau = {columns = ["tau1", "tau2", "tau3"], side = "motor", scale = [1, 2, 3]}',
        ("tau", 7),
    ),
    "current": (
        'tau = {columns = ["tau1", "tau2", "tau3"], unit = "A", side = "motor"}',
        ("tau", 7),
    ),
    "degrees": ('q = {columns = ["q1", "q2", "q3"], unit = "deg"}', ("q", 1)),
}


@pytest.mark.parametrize(("text", "signal"), MAPS.values(), ids=MAPS)
def test_a_line_does_at_the_link_what_the_repair_says_whatever_the_map(
    arm, table, tmp_path, text, signal
):
    robot, (name, _) = arm(GEARS), signal
    columns = columns_of(text, tmp_path)
    before = getattr(read(table, robot, columns, tmp_path), name)
    repair = Repair(name, sign=(1, -1, 1), scale=(1.0, 2.0, 0.5), order=(2, 1, 3))
    line = format_repair_lines([repair], robot, columns)
    after = getattr(read(table, robot, columns_of(line, tmp_path), tmp_path), name)
    want = before[:, [1, 0, 2]] * [1, -2, 0.5]
    np.testing.assert_allclose(after, want, rtol=1e-8, atol=1e-12)


def test_names_with_quotes_and_backslashes_come_back(arm, tmp_path):
    odd = ['a"b', "c\\d", "Drehmoment °"]
    text = f"tau = {{columns = ['a\"b', 'c\\d', '{odd[2]}']}}"
    columns = columns_of(text, tmp_path)
    line = format_repair_lines([Repair("tau", (1,), sign=(-1,))], arm(), columns)
    assert tomllib.loads(line)["tau"]["columns"] == odd


def test_coupled_motors_have_no_line_for_one_joint_but_one_for_all(arm, tmp_path):
    robot = arm("[couplings]\nmotor_from_joint = [[9, 0, 0], [1, 9, 0], [0, 0, 9]]")
    columns = columns_of(MAPS["motor side"][0], tmp_path)
    assert format_repair_lines([Repair("q", (2,), sign=(-1,))], robot, columns) is None
    line = format_repair_lines([Repair("q", scale=0.5)], robot, columns)
    assert line.endswith('side = "motor", scale = [0.5, 0.5, 0.5]}')


@pytest.mark.parametrize(
    ("gravity", "line"),
    [
        ("[0, 0, -9810]", "gravity = [0, 0, -9.81]"),
        ("[0, -981, 0]", "gravity = [0, -9.81, 0]"),
        ("[0, 0, -9.81]", None),
        ("[0, 0, 0]", None),
        ("[0, 0, -1.62]", None),  # on the moon
    ],
)
def test_gravity_is_mended_in_the_robot_file(arm, gravity, line):
    assert format_gravity_line(arm(f"[robot]\ngravity = {gravity}")) == line
    # Grams and millimetres stand in the URDF.
    lines = format_repair_lines([Repair("robot", scale=1e-3)], arm(), ColumnMap())
    assert lines is None
