"""Bags, MCAP, exports of signal viewers: the same samples as a CSV of the same arm."""

import sys

import numpy as np
import pytest

from residual.errors import InputError
from tests.warehouse import log_files as files
from warehouse.logs import read_column_map, read_log

# Joints in another order than the robot's, and one that is not of the arm.
SHUFFLED = ("finger", "joint2", "joint1")


@pytest.fixture
def shuffled(samples):
    t, q, tau = samples[:, :1], samples[:, 1:3], samples[:, 3:]
    other = np.zeros_like(t)
    return np.hstack([t, other, q[:, ::-1], other, tau[:, ::-1]])


def write(tmp_path, kind, topics):
    if kind == "ros1":
        return files.write_bag(tmp_path / "log.bag", topics, 1)
    if kind == "cdr":
        return files.write_mcap(tmp_path / "log.mcap", topics)
    folder = tmp_path / "log"
    files.write_bag(folder, topics, 2, kind.removesuffix(" file"))
    if kind.endswith("file"):
        return str(next(p for p in folder.iterdir() if p.suffix != ".yaml"))
    return str(folder)


KINDS = ["ros1", "sqlite3", "mcap", "sqlite3 file", "mcap file", "cdr"]


@pytest.mark.parametrize("kind", KINDS)
def test_joint_states_are_the_samples_in_the_robots_order(tmp_path, robot, samples, shuffled, kind):
    path = write(tmp_path, kind, {"/js": files.messages(shuffled, SHUFFLED)})
    log, known = read_log(path, robot)
    assert log.t == pytest.approx(samples[:, 0] + 1000, abs=1e-9)
    np.testing.assert_array_equal(log.q, samples[:, 1:3])
    np.testing.assert_array_equal(log.tau, samples[:, 3:])
    assert log.qd is None
    assert known.ignored == ("finger.position", "finger.effort")
    assert "topic /js: joint1 = joint 1, joint2 = joint 2" in known.text
    part, _ = read_log(f"{path}@1:3", robot)
    np.testing.assert_array_equal(part.q, samples[100:300, 1:3])


def test_the_map_chooses_topic_names_clock_and_units(tmp_path, robot, samples):
    degrees = samples.copy()
    degrees[:, 1:3] = np.rad2deg(samples[:, 1:3])
    topics = {
        "/other": files.messages(samples, ("a", "b")),
        "/arm": files.messages(degrees, ("elbow", "base"), stamps=True),
    }
    path = write(tmp_path, "cdr", topics)
    (tmp_path / "map.toml").write_text(
        "bag = {topic = '/arm', joints = ['base', 'elbow'], time = 'record'}\n"
        "q = {columns = ['q1', 'q2'], unit = 'deg', sign = [1, -1]}\n"
    )
    log, known = read_log(path, robot, read_column_map(tmp_path / "map.toml"))
    np.testing.assert_allclose(log.q, samples[:, [2, 1]] * [1, -1], rtol=1e-14)
    assert log.t[0] == pytest.approx(1000.005, abs=1e-9)
    assert "base = joint 1, elbow = joint 2; time of recording" in known.text
    assert ("q2", "q2", "deg", "sign reversed") in known.channels


BAD = {
    "two topics": "joint states on several topics: /a, /b.\nSelect one in --map",
    "no topic": "no topic with joint states",
    "wrong topic": "no joint states on topic '/c', it has: /a.",
    "names": "has none of the robot's joints joint1, joint2; it has: x, y.",
    "missing": "has messages without joint 'joint2', they have: joint1, y.",
    "effort": "has no efforts",
    "stamps": "the headers of the joint states have no time",
    "torn": "is not a readable",
}


@pytest.mark.parametrize("kind", ["ros1", "cdr"])
@pytest.mark.parametrize("what", BAD)
def test_what_a_bag_lacks_is_told(tmp_path, robot, samples, what, kind):
    def states(names=("joint1", "joint2"), **gone):
        return files.messages(samples, names, **gone)

    topics = {
        "two topics": {"/a": states(), "/b": states()},
        "no topic": {},
        "names": {"/a": states(("x", "y"))},
        "missing": {"/a": states(("joint1", "y"))},
        "effort": {"/a": states(effort=True)},
        "stamps": {"/a": states(stamps=True)},
    }.get(what, {"/a": states()})
    path = write(tmp_path, kind, topics)
    columns = None
    if what == "wrong topic":
        (tmp_path / "map.toml").write_text("bag = {topic = '/c'}\n")
        columns = read_column_map(tmp_path / "map.toml")
    if what == "torn":
        (file,) = [p for p in [*tmp_path.rglob("log*.*")] if p.suffix != ".yaml"]
        file.write_bytes(file.read_bytes()[: file.stat().st_size // 3])
    with pytest.raises(InputError) as refused:
        read_log(path, robot, columns)
    assert BAD[what] in str(refused.value)
    assert str(refused.value).count("\n") <= 1


def test_without_the_extra_it_is_told(tmp_path, robot, samples, monkeypatch):
    path, library = write(tmp_path, "ros1", {"/js": files.messages(samples)}), "rosbags"
    for name in list(sys.modules):
        if name.split(".")[0] == library:
            monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.setitem(sys.modules, f"{library}.highlevel", None)
    monkeypatch.setitem(sys.modules, f"{library}.reader", None)
    with pytest.raises(InputError, match=r"needs the extra \[bags\]: pip install"):
        read_log(path, robot)


VIEWER = (
    "Signal Viewer export\r\nStation;Cell 4\r\n\r\n"
    "Time;J1;J2;I1;I2;Comment\r\n[ms];[deg];[deg];[Nm];[Nm];\r\n"
)
MAP = """
time = {column = "Time", unit = "ms"}
q = {columns = ["J1", "J2"], unit = "deg"}
tau = {columns = ["I1", "I2"]}
csv = {decimal = ","}
"""


def viewer(path, samples, head=VIEWER):
    rows = samples * [1e3, *[180 / np.pi] * 2, 1, 1]
    lines = [";".join(f"{x:.9f}".replace(".", ",") for x in row) + ";" for row in rows]
    path.write_bytes((head + "\r\n".join(lines) + "\r\n").encode("latin-1"))
    return str(path)


@pytest.mark.parametrize(
    "head",
    [VIEWER, VIEWER.replace("[", "").replace("]", ""), "Signal Viewer\r\nTime;J1;J2;I1;I2;\r\n"],
)
def test_an_export_of_a_signal_viewer_is_read(tmp_path, robot, samples, head):
    (tmp_path / "map.toml").write_text(MAP)
    columns = read_column_map(tmp_path / "map.toml")
    log, known = read_log(viewer(tmp_path / "a.csv", samples, head), robot, columns)
    np.testing.assert_allclose(log.q, samples[:, 1:3], atol=1e-9)
    np.testing.assert_allclose(log.tau, samples[:, 3:], atol=1e-9)
    np.testing.assert_allclose(log.t, samples[:, 0], atol=1e-9)
    assert "above the names" in known.text


def test_a_unit_that_the_file_contradicts_is_an_error(tmp_path, robot, samples):
    (tmp_path / "map.toml").write_text(MAP.replace('unit = "deg"', 'unit = "rad"'))
    columns = read_column_map(tmp_path / "map.toml")
    with pytest.raises(InputError, match="'J1' is in deg by the file, in rad by"):
        read_log(viewer(tmp_path / "a.csv", samples), robot, columns)
