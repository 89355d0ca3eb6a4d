"""Bodies that no link has are told from the robot file, repaired and left open."""

import xml.etree.ElementTree as ET

import numpy as np
import pytest

from residual.check.check import check_logs
from residual.evidence.priors import compute_inertial_sd
from residual.model.bodies import build_pseudo_inertias
from residual.robot.dynamics import read_inertial_parameters
from residual.robot.limits import find_limit_flaws
from residual.robot.plausibility import describe_body_flaws
from residual.robot.robot import build_robot
from tests.residual.arms import plain_logs, urdf_text

KEYS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")


def robot_with(edits, extra=""):
    """The small arm of three joints with other values of its links' <inertial>."""
    root = ET.fromstring(urdf_text(("0 0 1", "0 1 0", "0 1 0"), extra))
    for link, values in edits.items():
        inertial = root.find(f"link[@name='{link}']/inertial")
        if "mass" in values:
            inertial.find("mass").set("value", str(values["mass"]))
        if "xyz" in values:
            inertial.find("origin").set("xyz", values["xyz"])
        for key, value in zip(KEYS, values.get("tensor", ()), strict=False):
            inertial.find("inertia").set(key, str(value))
    return build_robot("arm", ET.tostring(root, encoding="unicode"), "{}")


SHARED = {"tensor": (0.021, 0.05, 0.05, 0, 0, 0)}
FLAWS = {
    "moment above the others": ({"l2": {"tensor": (0.02, 0.02, 0.3)}}, "impossible"),
    "negative moment": ({"l2": {"tensor": (0.02, -0.03, 0.03)}}, "impossible"),
    "product too large": ({"l2": {"tensor": (0.02, 0.02, 0.02, 0.05)}}, "impossible"),
    "tensor without mass": ({"l2": {"mass": 0, "tensor": (0.2,) * 3}}, "impossible"),
    "ones": ({"l2": {"tensor": (1.0, 1.0, 1.0)}}, "spread"),
    "kg mm^2": ({"l2": {"tensor": (2e4, 6e4, 6e4)}}, "spread"),
    "denser than gold": ({"l2": {"tensor": (1e-6, 1.2e-6, 1.3e-6)}}, "dense"),
    "a ball of one digit": ({"l2": {"tensor": (0.02, 0.02, 0.02)}}, "placeholder"),
    "centre in mm": ({"l2": {"xyz": "150 10 20"}}, "centre"),
    "mass in g": ({"l2": {"mass": 3000}}, "mass"),
}


@pytest.mark.parametrize(("edits", "kind"), FLAWS.values(), ids=FLAWS)
def test_a_body_that_no_link_has_is_told_and_left_open(edits, kind):
    sound, robot = robot_with({}), robot_with(edits)
    assert sound.flaws == ()
    assert [(f.link, f.joint, f.kind) for f in robot.flaws] == [("l2", 2, kind)]
    doubt = robot.flaws[0].doubt
    left = 0.01 * compute_inertial_sd(robot, 0.01).reshape(3, 10)[1]
    assert doubt[4:].min() > 0
    assert (left >= 0.999 * doubt).all()  # under the finest prior, too
    if kind == "impossible":
        bodies = build_pseudo_inertias(read_inertial_parameters(robot.model))
        least = np.linalg.eigvalsh(bodies[1])[0]
        assert least == 0 if "mass" in edits["l2"] else least > 0
    else:
        given = robot.model.inertias[2].mass
        assert given == edits["l2"].get("mass", sound.model.inertias[2].mass)


@pytest.fixture(scope="module")
def sound_logs():
    return plain_logs(robot_with({}), range(3), np.zeros(3))


# A check takes a second, so of each kind one.
@pytest.mark.parametrize("edits", {kind: e for e, kind in FLAWS.values()}.values())
def test_no_log_is_blamed_for_a_body_that_no_link_has(edits, sound_logs):
    """Whatever the file says: no crash, and nothing of the log is certain."""
    faults = check_logs(robot_with(edits), sound_logs).faults
    assert "robot_file" in {f.kind for f in faults}
    assert {f.kind for f in faults if f.certain} <= {"robot_file"}


def test_one_tensor_on_links_of_different_mass_is_a_placeholder_of_each():
    robot = robot_with({"l2": SHARED, "l3": SHARED})
    assert [f.kind for f in robot.flaws] == ["placeholder", "placeholder"]
    (words,) = describe_body_flaws(robot.flaws)
    assert words.startswith("Links 'l2', 'l3': tensor ixx 0.021")
    twins = {"l2": SHARED | {"mass": 2}, "l3": SHARED | {"mass": 2}}
    assert robot_with(twins).flaws == ()  # one part used twice


def test_a_repaired_body_keeps_hash_mass_and_centre_of_the_file():
    edits = {"l2": {"tensor": (0.02, 0.02, 0.3)}}
    robot, sound = robot_with(edits), robot_with({})
    body, other = robot.model.inertias[2], sound.model.inertias[2]
    assert body.mass == other.mass
    np.testing.assert_allclose(body.lever, other.lever)
    moments = np.linalg.eigvalsh(body.inertia)
    assert moments[0] + moments[1] > moments[2] > 0.29
    again = build_robot(robot.name, robot.urdf, robot.toml)
    assert again.content_hash == robot.content_hash
    assert 'izz="0.3"' in robot.urdf


def test_limits_that_no_arm_has_are_told():
    text = urdf_text().replace('effort="200"', 'effort="1"', 1)
    text = text.replace('velocity="3"', 'velocity="300"', 1)
    (_, speed), (_, torque) = find_limit_flaws(build_robot("arm", text, "{}"))
    assert "speed limit is 300 rad/s" in speed
    assert "torque limit is 1 N m" in torque
    assert find_limit_flaws(robot_with({})) == []
