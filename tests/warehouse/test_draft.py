"""A drafted map: what is found by names, units, joints and numbers, and what is not."""

import tomllib

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from flows.steps.check import format_drafted_map as drafted_map
from residual.robot.robot import load_robot
from tests.residual.arms import SEVEN, arm, urdf_text
from tests.warehouse.foreign_logs import FOLDER, FORMATS
from tests.warehouse.log_files import messages, write_bag
from warehouse.logs import read_log
from warehouse.logs.column_map import read_column_map
from warehouse.logs.map_draft import draft_column_map


def arm_of(form):
    return arm(SEVEN[: form.dof])


@pytest.mark.parametrize("name", FORMATS)
def test_the_format_of_a_maker_is_known_by_its_names(name):
    form = FORMATS[name]
    proposed = draft_column_map(FOLDER / form.file, arm_of(form))
    joints = range(form.dof)
    assert proposed.format == name
    assert proposed.columns.time == form.time[0]
    assert proposed.columns.time_unit_seconds == 1 / form.time[1]
    assert proposed.columns.signals["q"].columns == tuple(map(form.q, joints))
    assert proposed.columns.signals["tau"].columns == tuple(map(form.tau, joints))
    unit = "rad" if form.angle == 1 else "deg"
    assert proposed.columns.signals["q"].unit == unit
    assert proposed.missing == ()
    (question,) = proposed.doubts["tau"]
    assert question.startswith("which ")
    assert "gravity = [0, 0, 0]" in question
    # What was asked of the arm, or guessed about forces from outside, is none of it.
    used = {c for s in proposed.columns.signals.values() for c in s.columns}
    assert not [c for c in used if "target" in c or "cmd" in c or "ext" in c]


PAN = ("shoulder_pan_joint", "elbow_joint")
URDF_NAMES = (
    "Timestamp [ms];shoulder_pan_pos [deg];elbow_pos [deg];shoulder_pan_eff [Nm];elbow_eff [Nm]",
    "time_ms;pos_deg_shoulder_pan;pos_deg_elbow;torque_shoulder_pan;torque_elbow",
    "t;Shoulder_Pan_Joint.position;Elbow_Joint.position;"
    "Shoulder_Pan_Joint.effort;Elbow_Joint.effort",
    "Zeit;Achse 1 Ist;Achse 2 Ist;Achse 1 Drehmoment;Achse 2 Drehmoment",
    "time_ms;base_pos [deg];arm_pos [deg];base_effort [Nm];arm_effort [Nm]",
    "time [ms];qpos[0] [deg];qpos[1] [deg];qfrc_actuator[0];qfrc_actuator[1]",
    "__time [ms];/joint_states/j_1/position;/joint_states/j_2/position;"
    "/joint_states/j_1/effort;/joint_states/j_2/effort",
)


def two(tmp_path):
    """An arm of two joints with names as those of public URDFs."""
    text = urdf_text().replace('"j1"', f'"{PAN[0]}"').replace('"j2"', f'"{PAN[1]}"')
    (tmp_path / "two.urdf").write_text(text)
    return load_robot(tmp_path / "two.urdf")


@pytest.fixture
def table():
    """Time [ms], two angles [deg], two torques [N m] at 100 Hz."""
    t = np.arange(300) * 10.0
    q = np.column_stack([90 * np.sin(t / 800), 70 * np.cos(t / 500)])
    return np.column_stack([t, q, 3 * q[:, ::-1] + 1])


def write(path, header, table, decimal=".", separator=";"):
    lines = [header]
    for row in table:
        lines.append(separator.join(f"{x:.5f}".replace(".", decimal) for x in row))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("decimal", [".", ","])
@pytest.mark.parametrize("header", URDF_NAMES)
def test_names_of_joints_units_and_a_decimal_comma_are_understood(tmp_path, table, header, decimal):
    robot = two(tmp_path)
    path = write(tmp_path / "log.csv", header, table, decimal)
    text = drafted_map(draft_column_map(path, robot), str(path), robot)
    (tmp_path / "C.toml").write_text(text, encoding="utf-8")
    log, _ = read_log(str(path), robot, read_column_map(tmp_path / "C.toml"))
    np.testing.assert_allclose(log.t, table[:, 0] / 1000, atol=1e-9)
    np.testing.assert_allclose(log.q, np.deg2rad(table[:, 1:3]), atol=1e-6)
    np.testing.assert_allclose(log.tau, table[:, 3:], atol=1e-4)


@pytest.mark.parametrize(("step", "unit"), [(0.002, "s"), (4.0, "ms"), (2000.0, "us"), (4e6, "ns")])
def test_the_unit_of_time_is_that_in_which_an_arm_is_logged(tmp_path, step, unit):
    n = np.arange(50)
    table = np.column_stack([step * n, *(np.sin(n / k) for k in range(5, 9))])
    path = write(tmp_path / "a.csv", "time;q1;q2;tau1;tau2", table)
    columns = draft_column_map(path, two(tmp_path)).columns
    seconds = {"s": 1, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[unit]
    assert columns.time_unit_seconds == pytest.approx(seconds)


def test_names_of_strangers_are_in_order_of_header_and_that_is_said(tmp_path, table):
    header = "t_ms;up_pos;down_pos;up_torque;down_torque"
    proposed = draft_column_map(write(tmp_path / "a.csv", header, table), two(tmp_path))
    assert proposed.columns.signals["q"].columns == ("up_pos", "down_pos")
    assert proposed.columns.signals["tau"].columns == ("up_torque", "down_torque")
    for signal in ("q", "tau"):
        assert "in the order of the header" in proposed.doubts[signal][0]
    # A joint that is not there is no stranger.
    path = write(tmp_path / "b.csv", "t_ms;q1;x;tau1;y", table)
    assert draft_column_map(path, two(tmp_path)).missing == ("q", "tau")


@pytest.mark.parametrize("effort", [True, False])
def test_lists_of_lerobot_are_columns_and_torque_is_asked_for(tmp_path, table, effort):
    q, tau = np.deg2rad(table[:, 1:3]), table[:, 3:]
    lists = {"observation.state": q.tolist(), "action": q.tolist()}
    if effort:
        lists["observation.effort"] = pa.array(tau.tolist(), pa.list_(pa.float32(), 2))
    lists |= {"timestamp": table[:, 0] / 1000, "episode_index": [0] * len(q)}
    pq.write_table(pa.table(lists), tmp_path / "a.parquet")
    robot = two(tmp_path)
    proposed = draft_column_map(tmp_path / "a.parquet", robot)
    assert proposed.format == "lerobot"
    if not effort:
        assert "without torque or current" in proposed.doubts["tau"][0]
        return
    log, _ = read_log(str(tmp_path / "a.parquet"), robot, proposed.columns)
    np.testing.assert_array_equal(log.q, q)
    np.testing.assert_allclose(log.tau, tau, rtol=1e-6)


def test_what_is_not_found_is_a_comment_with_all_that_is_there(tmp_path, table):
    robot = two(tmp_path)
    path = write(tmp_path / "a.csv", "t;q1;q2;left;right", table)
    proposed = draft_column_map(path, robot)
    assert proposed.missing == ("tau",)
    text = drafted_map(proposed, "a.csv", robot)
    assert '# tau = {columns = ["...", "..."], unit = "..."}' in text
    assert "# not read: left right" in text
    assert set(tomllib.loads(text)) == {"time", "q"}


def test_names_that_would_break_out_of_a_comment_stay_in_it(tmp_path, table):
    names = ["t", "q1", "q2", "tau1", "tau2"]
    names += ["x\nq = {columns = ['evil']}\x1b[2J\u202e"]
    columns = dict(zip(names, [*table.T, table[:, 0]], strict=True))
    pq.write_table(pa.table(columns), tmp_path / "a.parquet")
    robot = two(tmp_path)
    text = drafted_map(draft_column_map(tmp_path / "a.parquet", robot), "a.parquet", robot)
    assert tomllib.loads(text)["q"]["columns"] == ["q1", "q2"]
    assert all(c.isprintable() or c == "\n" for c in text)


def test_a_bag_with_other_names_gets_its_joints_and_its_topic(tmp_path, table):
    robot = two(tmp_path)
    samples = table * [1e-3, *2 * [np.pi / 180], 1, 1]
    topics = {
        "/gripper": messages(samples[:, [0, 1, 3]], ("finger",)),
        "/arm": messages(samples, ("arm_shoulder_pan", "arm_elbow")),
    }
    path = write_bag(tmp_path / "log.bag", topics, version=1)
    text = drafted_map(draft_column_map(tmp_path / "log.bag", robot), path, robot)
    line = 'bag = {topic = "/arm", joints = ["arm_shoulder_pan", "arm_elbow"]}'
    assert line in text
    (tmp_path / "C.toml").write_text(text)
    log, _ = read_log(path, robot, read_column_map(tmp_path / "C.toml"))
    np.testing.assert_allclose(log.q, samples[:, 1:3])


GOALS = {
    "goal_position_#;present_position_#": "goal_position_",
    "action.#;observation.state.#": "action.",
    "desired_position_#;feedback_position_#": "desired_position_",
}


@pytest.mark.parametrize("header", GOALS)
def test_goals_without_torque_are_drafted_with_a_drive(header, tmp_path):
    wanted, present = header.split(";")
    names = [n.replace("#", str(j)) for n in (wanted, present) for j in (1, 2)]
    t = np.arange(0, 3, 0.01)
    columns = [t, *(np.sin(t + k) for k in range(4)), np.round(np.sin(t)), t < 2]
    columns.insert(6, np.round(np.cos(t)))
    text = ",".join(["t", *names, "current_1", "current_2", "torque_enable"])
    np.savetxt(tmp_path / "log.csv", np.column_stack(columns), "%.6f", ",", "\n", text, comments="")
    draft = draft_column_map(tmp_path / "log.csv", arm())
    assert draft.columns.signals["q_ref"].columns[0] == GOALS[header] + "1"
    assert draft.columns.signals["q"].columns == tuple(names[2:])
    assert "tau" not in draft.columns.signals
    assert draft.columns.drive.enabled == "torque_enable"
    assert "no torque" in draft.doubts["drive"][0]
    assert "is q_ref the goal" in draft.doubts["drive"][1]
    written = drafted_map(draft, "log.csv", arm())
    assert tomllib.loads(written)["drive"] == {"enabled": "torque_enable"}


@pytest.mark.parametrize("words", ["goal_position present_position load_current", "goal q current"])
def test_an_arm_of_one_joint_needs_no_number_in_its_columns(words, tmp_path):
    t = np.arange(0, 3, 0.01)
    table = np.column_stack([t, np.sin(t), np.sin(t - 0.1), np.round(np.cos(t))])
    header = ",".join(["time", *words.split()])
    np.savetxt(tmp_path / "log.csv", table, "%.6f", ",", "\n", header, comments="")
    draft = draft_column_map(tmp_path / "log.csv", arm(SEVEN[:1]))
    goal, present, current = words.split()
    found = {k: s.columns for k, s in draft.columns.signals.items()}
    assert found == {"q_ref": (goal,), "q": (present,)}
    assert f"{current} has 3 values" in draft.doubts["drive"][0]
