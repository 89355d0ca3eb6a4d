"""Loading robots: what is accepted, what is said of what is not, bodies that no link has."""

import xml.etree.ElementTree as ET

import numpy as np
import pytest

from flows.inputs import load_command_robot
from residual.check.check import check_logs
from residual.effects import list_effect_parameters
from residual.errors import RobotError, UnknownNameError
from residual.evidence.priors import compute_inertial_sd
from residual.model.bodies import build_pseudo_inertias
from residual.robot.dynamics import read_inertial_parameters
from residual.robot.limits import find_limit_flaws
from residual.robot.plausibility import describe_body_flaws
from residual.robot.robot import add_known_values, build_robot, load_robot, set_serial_number
from tests.residual.arms import plain_logs, urdf_text

JOINT = """
  <joint name="joint{i}" type="{kind}">
    <parent link="link{parent}"/><child link="link{i}"/>
    <origin xyz="0 0 0.4"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" velocity="3" effort="50"/>{extra}
  </joint>
  <link name="link{i}">{inertial}</link>"""
INERTIAL = """<inertial><origin xyz="0 0 0.2"/><mass value="2"/>
    <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>"""


def joint(i, kind="revolute", parent=None, extra="", inertial=INERTIAL):
    parent = i - 1 if parent is None else parent
    return JOINT.format(i=i, kind=kind, parent=parent, extra=extra, inertial=inertial)


def urdf(*joints):
    return f'<robot name="Two Link"><link name="link0"/>{"".join(joints)}\n</robot>'


TWO_LINK = urdf(joint(1), joint(2))


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "arm.urdf").write_text(TWO_LINK)
    return tmp_path


def test_built_in_irb140_has_the_published_geometry_and_labels_what_is_assumed():
    robot = load_robot("irb140")
    assert (robot.name, robot.dof, robot.model.nq) == ("irb140", 6, 6)
    np.testing.assert_allclose(
        np.rad2deg([robot.lower, robot.upper]),
        [[-180, -90, -230, -200, -115, -400], [180, 110, 50, 200, 115, 400]],
        atol=1e-4,
    )
    np.testing.assert_allclose(
        np.rad2deg(robot.velocity_limit), [200, 200, 260, 360, 360, 450], atol=1e-3
    )
    base_mass = 26.36
    moving_mass = sum(body.mass for body in list(robot.model.inertias)[1:])
    assert base_mass + moving_mass == pytest.approx(98, abs=0.05)
    assert set(robot.declared) == {"viscous", "coulomb", "rotor_inertia"}
    assert all(d.assumed and "TX40" in d.source for d in robot.declared.values())


def test_a_robot_file_has_the_toml_of_its_folder_unless_another_arm_is_there(folder):
    (folder / "robot.toml").write_text("[declared.coulomb]\nlevel = [3, 4]\n")
    robot = load_robot(folder / "arm.urdf")
    assert robot.content_hash == load_robot(folder).content_hash
    np.testing.assert_array_equal(robot.declared["coulomb"].values["level"], [3, 4])
    assert robot.notes == ("with the robot.toml beside arm.urdf",)
    (folder / "other.urdf").write_text((folder / "arm.urdf").read_text())
    bare = load_robot(folder / "arm.urdf")
    assert (dict(bare.declared), bare.prior_scale) == ({}, None)
    assert "robot.toml is not read" in bare.notes[0]


def test_robot_toml_values_arrive(folder):
    (folder / "robot.toml").write_text(
        "[robot]\ngravity = [0, 9.81, 0]\n"
        "[joints]\ngear_ratio = [100, -50]\ntorque_limit = [10, 20]\n"
        "[declared.coulomb]\nlevel = [3, 4]\n[declared.viscous]\n"
        "[couplings]\nmotor_from_joint = [[100, 0], [3, -50]]\n"
        "[prior]\nscale = 0.03\n"
    )
    robot = load_robot(folder)
    np.testing.assert_array_equal(robot.model.gravity.linear, [0, 9.81, 0])
    np.testing.assert_array_equal(robot.torque_limit, [10, 20])
    np.testing.assert_array_equal(robot.velocity_limit, [3, 3])
    np.testing.assert_array_equal(robot.transmission, [[100, 0], [3, -50]])
    np.testing.assert_array_equal(robot.declared["coulomb"].values["level"], [3, 4])
    assert dict(robot.declared["viscous"].values) == {}
    assert robot.prior_scale == 0.03


def test_continuous_becomes_revolute_and_fixed_merges(folder):
    fixed = joint(3, kind="fixed")
    text = urdf(joint(1), joint(2, kind="continuous"), fixed)
    (folder / "arm.urdf").write_text(text)
    robot = load_robot(folder)
    assert (robot.dof, robot.model.nq, robot.model.nv) == (2, 2, 2)
    np.testing.assert_array_equal(robot.upper, [2, np.inf])
    assert robot.model.inertias[2].mass == pytest.approx(4)


def test_content_hash_follows_the_urdf_and_the_meaning_of_the_toml(folder):
    bare = load_robot(folder).content_hash
    (folder / "robot.toml").write_text('# note\n[robot]\nname = "a"\n')
    named = load_robot(folder).content_hash
    (folder / "robot.toml").write_text('robot = {name = "a"}\n')
    assert load_robot(folder).content_hash == named != bare
    assert len(named) == 64


BAD_URDF = {
    "not xml": ("<robot", "does not parse"),
    "other xml": ("<sdf/>", "root is <sdf>"),
    "xacro": ('<robot xmlns:x="http://ros.org/xacro"><x:include/></robot>', "Name it .xacro"),
    "no joint": (urdf(), "no revolute, continuous"),
    "massless": (urdf(joint(1, inertial="")), "'joint1' moves has a mass"),
    "mass is text": (TWO_LINK.replace('value="2"', 'value="m"'), "expected a finite number"),
    "negative mass": (TWO_LINK.replace('value="2"', 'value="-2"'), "expected >= 0"),
    "mass that overflows": (TWO_LINK.replace('value="2"', 'value="1e308"'), r"beyond 1e\+30"),
    "origin that overflows": (
        TWO_LINK.replace("<inertial>", '<inertial><origin xyz="1e200 0 0"/>'),
        r"at joint '.*' is beyond 1e\+30",
    ),
    "only comments": ("<robot><!-- see the xacro --></robot>", "has no link"),
    "mimic": (
        urdf(joint(1), joint(2, extra='<mimic joint="joint1"/>')),
        "'joint2' follows 'joint1', which is in the chain",
    ),
    "branches": (
        urdf(joint(1), joint(2), joint(3, parent=1)),
        "2 chains.*--tip link2: 2 joints, joint1 to joint2",
    ),
    "no child": (TWO_LINK.replace('<child link="link2"/>', ""), "lacks a parent"),
    "two bases": (urdf(joint(1), joint(3, parent=2)), "'link2', which is not found"),
    "link on two joints": (
        TWO_LINK.replace('<child link="link1"/>', '<child link="link2"/>'),
        "'link2' hangs on two joints",
    ),
    "unknown parent": (urdf(joint(1), joint(2, parent=7)), "not found"),
    "unknown child": (TWO_LINK.replace('<link name="link2">', '<link name="l">'), "link"),
    "no tensor": (TWO_LINK.replace("<inertia ", "<x "), "must have inertia"),
}


@pytest.mark.parametrize(("text", "message"), BAD_URDF.values(), ids=BAD_URDF)
def test_bad_urdf_is_refused_in_one_or_two_lines(tmp_path, capfd, text, message):
    (tmp_path / "arm.urdf").write_text(text)
    with pytest.raises(RobotError, match=message) as caught:
        load_robot(tmp_path)
    assert len(str(caught.value)) < 250
    assert "\n" not in str(caught.value)
    assert capfd.readouterr().err == ""


BAD_TOML = {
    "not toml": ("[robot", "not valid TOML"),
    "unknown table": ("[joint]", "did you mean 'joints'"),
    "unknown key": ("[joints]\ngearratio = [1, 1]", "did you mean 'gear_ratio'"),
    "unknown effect": ("[declared.coulom]", "did you mean 'coulomb'"),
    "unknown parameter": ("[declared.coulomb]\nlevels = []", "did you mean 'level'"),
    "bare key": ("robot = 3", "must be a table"),
    "effect no table": ("[declared]\ncoulomb = [1, 2]", r"\[declared.coulomb\]"),
    "length": ("[joints]\ngear_ratio = [1]", "gear_ratio needs 2 numbers, got 1"),
    "text": ("[joints]\ngear_ratio = 'x'", "needs 2 numbers, got none"),
    "nan": ("[joints]\ngear_ratio = [1, nan]", "finite"),
    "zero gear": ("[joints]\ngear_ratio = [1, 0]", "must not be 0"),
    "negative limit": ("[joints]\ntorque_limit = [1, -1]", "must be positive"),
    "gravity": ("[robot]\ngravity = 9.81", "gravity needs 3 numbers"),
    "name": ("[robot]\nname = 'IRB 140'", "1 to 40"),
    "scale": ("[prior]\nscale = 0", "'estimate' or a positive"),
    "no source": ("[declared.coulomb]\nlevel = [1, 1]\nassumed = true", "need a source"),
    "assumed": ("[declared.coulomb]\nassumed = 1", "true or false"),
    "coupling size": ("[couplings]\nmotor_from_joint = [1, 1]", "needs 2 x 2 numbers, got 2"),
    "coupling": ("[couplings]\nmotor_from_joint = [[1, 1], [1, 1]]", "must be invertible"),
}


@pytest.mark.parametrize(("text", "message"), BAD_TOML.values(), ids=BAD_TOML)
def test_bad_robot_toml_is_refused(folder, text, message):
    (folder / "robot.toml").write_text(text)
    with pytest.raises((RobotError, UnknownNameError), match=message):
        load_robot(folder, list_effect_parameters())


def test_effects_are_checked_by_who_knows_them(folder):
    (folder / "robot.toml").write_text("[declared.creaking]\nlevel = [1, 2]\n")
    declared = load_robot(folder).declared["creaking"]
    np.testing.assert_array_equal(declared.values["level"], [1, 2])
    with pytest.raises(UnknownNameError, match=r"effect in robot\.toml .creaking"):
        load_command_robot(str(folder))


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("irb14", "did you mean 'irb140'.* Or give a URDF, xacro or MJCF file, or a fold"),
        ("nothing/like/it", "No file or folder"),
        ("arm.urdf", "No file or folder 'arm.urdf'"),
        ("/dev/null", "No file or folder"),
    ],
)
def test_robot_that_is_not_there_is_named(tmp_path, monkeypatch, spec, message):
    monkeypatch.chdir(tmp_path)
    with pytest.raises((RobotError, UnknownNameError), match=message):
        load_robot(spec)


def test_a_folder_of_two_arms_and_a_binary_file_are_refused(folder, tmp_path):
    (folder / "second.urdf").write_text(TWO_LINK)
    with pytest.raises(RobotError, match=r"found arm.urdf, second.urdf"):
        load_robot(folder)
    (tmp_path / "arm.urdf").write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(RobotError, match="not a text file"):
        load_robot(tmp_path / "arm.urdf")


def test_a_serial_number_and_known_values_keep_the_order_of_what_is_declared():
    """It is that of the columns of a fit: sums in another order have other bits."""
    kind = load_robot("irb140")
    numbered = set_serial_number(kind, "B-18")
    weighed = add_known_values(kind, {"payload.mass": 2.0})
    for robot in (numbered, weighed):
        assert list(robot.declared) == list(kind.declared)
    assert numbered.content_hash != kind.content_hash
    # What is known of an arm today is no other arm: its records find its description.
    assert weighed.content_hash == kind.content_hash
    assert weighed.known_values["payload.mass"] == 2.0


# Bodies that no link has are told from the robot file, repaired and left open.


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
