"""A drafted map: of tables as machines write them, by names, units and numbers."""

import itertools
import tomllib
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from flows.steps.check import format_drafted_map
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
    text = format_drafted_map(draft_column_map(path, robot), str(path), robot)
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
    text = format_drafted_map(proposed, "a.csv", robot)
    assert '# tau = {columns = ["...", "..."], unit = "..."}' in text
    assert "# not read: left right" in text
    assert set(tomllib.loads(text)) == {"time", "q"}


def test_names_that_would_break_out_of_a_comment_stay_in_it(tmp_path, table):
    names = ["t", "q1", "q2", "tau1", "tau2"]
    names += ["x\nq = {columns = ['evil']}\x1b[2J\u202e"]
    columns = dict(zip(names, [*table.T, table[:, 0]], strict=True))
    pq.write_table(pa.table(columns), tmp_path / "a.parquet")
    robot = two(tmp_path)
    text = format_drafted_map(draft_column_map(tmp_path / "a.parquet", robot), "a.parquet", robot)
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
    text = format_drafted_map(draft_column_map(tmp_path / "log.bag", robot), path, robot)
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
    written = format_drafted_map(draft, "log.csv", arm())
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
    assert f"{current} has only 3 values" in draft.doubts["drive"][0]


# Tables as machines write them: heads x columns of text x separators x decimal marks.


DEG = 180 / np.pi


@dataclass(frozen=True)
class Head:
    """Names of time, two angles and two torques; units in a second, radian and N m."""

    names: tuple[str, ...]
    second: float = 1.0
    radian: float = 1.0
    newton_metre: float = 1.0
    units: tuple[str, ...] = ()  # a line of their own


HEADS = (
    Head(("t", "q1", "q2", "tau1", "tau2")),
    Head(("Time [ms]", "Joint 1 [deg]", "Joint 2 [deg]", "T1 [Nm]", "T2 [Nm]"), 1e3, DEG),
    Head(("Zeit", "Achse1_Ist", "Achse2_Ist", "Moment1", "Moment2"), 1e3, DEG),
    Head(("X_Value", "Position_0", "Position_1", "Torque_0", "Torque_1")),
    Head(("time_ms", "pos_deg_1", "pos_deg_2", "trq_Nmm_1", "trq_Nmm_2"), 1e3, DEG, 1e3),
    Head(
        ("Clock (s)", "A1 Pos (deg)", "A2 Pos (deg)", "A1 Eff (N mm)", "A2 Eff (N mm)"),
        radian=DEG,
        newton_metre=1e3,
    ),
    Head(("stamp_us", "shoulder_angle", "elbow_angle", "shoulder_effort", "elbow_effort"), 1e6),
    Head(("Elapsed", "Ax1.ActPos", "Ax2.ActPos", "Ax1.ActTorque", "Ax2.ActTorque"), radian=DEG),
    Head(("Time", "J1", "J2", "M1", "M2"), 1e3, DEG, units=("ms", "deg", "deg", "Nm", "Nm")),
    Head(("t_us", "theta_1", "theta_2", "motor_torque_1", "motor_torque_2"), 1e6),
    Head(("Messzeit", "Istwinkel 1", "Istwinkel 2", "Istmoment 1", "Istmoment 2")),
    Head(
        ("Zeit", "Winkel 1", "Winkel 2", "Drehmoment 1", "Drehmoment 2"),
        radian=DEG,
        units=("[s]", "[°]", "[°]", "[Nm]", "[Nm]"),
    ),
)
# Columns of text: where, name, unit, values in turn.
TEXTS = {
    "none": (),
    "status": ((0, "Status", "", ("RUN",)),),
    "mode, last": ((5, "Mode", "", ("AUTO", "AUTO", "", "T1, slow")),),
    "ISO time": ((0, "Timestamp", "", ("2026-11-20T14:03:00.004",)),),
    "truth": ((3, "Enabled", "-", ("TRUE", "FALSE")),),
    "joint states": (
        (1, "Joint1_State", "", ("ok",)),
        (1, "Joint2_State", "", ("brake", "ok")),
        (7, "Time of day", "", ("14:03:00",)),
    ),
}
SEPARATORS = (";", "\t", ",", "|", " ", " ; ")
ABOVE = ("", "Controller 7\nRate;250\n\n", "Log of cell 4, started by hand\nAxes: 2\n")
ROWS = 50


def build_table(head, texts, separator, decimal, above):
    """Return the text of a table and the samples in SI units."""
    t = np.arange(ROWS) * 0.05
    q = np.column_stack([1.6 * np.sin(4 * t), 1.2 * np.cos(5.5 * t)])
    tau = 9.0 * q[:, ::-1] + 0.25
    samples = np.column_stack([t, q, tau])
    factors = [head.second, *2 * [head.radian], *2 * [head.newton_metre]]
    columns = [[f"{x:.6f}".replace(".", decimal) for x in c] for c in (samples * factors).T]
    columns = [[n, *c] for n, c in zip(head.names, columns, strict=True)]
    if head.units:
        columns = [[n, u, *c] for (n, *c), u in zip(columns, head.units, strict=True)]
    for place, name, unit, words in texts:
        cells = itertools.islice(itertools.cycle(words), ROWS)
        columns.insert(place, [name, *([unit] if head.units else []), *cells])
    bare = separator.strip() or separator
    lines = [
        separator.join(f'"{c}"' if bare in c else c for c in row)
        for row in zip(*columns, strict=True)
    ]
    lines[0] = f"# {lines[0]}" if "t_us" in head.names else lines[0]
    return above + "\n".join([*lines, ""]), samples


@pytest.mark.parametrize("texts", TEXTS.values(), ids=TEXTS)
@pytest.mark.parametrize("head", HEADS, ids=lambda head: head.names[1])
def test_a_table_with_columns_of_text_is_read_by_its_drafted_map(tmp_path, head, texts):
    (tmp_path / "two.urdf").write_text(
        urdf_text().replace('"j1"', '"shoulder"').replace('"j2"', '"elbow"')
    )
    robot = load_robot(tmp_path / "two.urdf")
    log, file = tmp_path / "log.csv", tmp_path / "C.toml"
    # A sixth of all separators, decimal marks and lines above: others in each test.
    first = (HEADS.index(head) + list(TEXTS.values()).index(texts)) % 6
    forms = list(itertools.product(SEPARATORS, ".,"))[first::6]
    for n, (separator, decimal) in enumerate(forms):
        text, samples = build_table(
            head, texts, separator, decimal, ABOVE[(first + n) % len(ABOVE)]
        )
        log.write_text(text, encoding="utf-8")
        drafted = format_drafted_map(draft_column_map(log, robot), log.name, robot)
        case = f"{text[:300]}\n{drafted}"
        file.write_text(drafted, encoding="utf-8")
        columns = read_column_map(file)
        named = {columns.time, *(c for s in columns.signals.values() for c in s.columns)}
        assert named <= {*head.names}, case
        recording, _ = read_log(str(log), robot, columns)
        np.testing.assert_allclose(recording.t, samples[:, 0], atol=1e-6, err_msg=case)
        np.testing.assert_allclose(recording.q, samples[:, 1:3], atol=1e-6, err_msg=case)
        np.testing.assert_allclose(recording.tau, samples[:, 3:], atol=1e-5, err_msg=case)
        assert len(recording.t) == ROWS, case
