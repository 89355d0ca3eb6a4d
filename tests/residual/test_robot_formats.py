"""MJCF by MuJoCo's compiler and xacro by xacrodoc: the same arm as a URDF has."""

import numpy as np
import pytest

from flows.inputs import load_command_robot as load_arm
from residual.errors import InputError, RobotError
from residual.robot.dynamics import LazyRegressor, read_inertial_parameters
from residual.robot.robot import build_robot, load_robot, write_urdf_with_inertias
from tests.residual.arms import urdf_text

mujoco = pytest.importorskip("mujoco", reason="the extra mjcf is not installed")

MJCF = """<mujoco model="Odd Arm">
  <option gravity="0.3 0 -9.7"/>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <body name="column" pos="0.1 0 0.2" euler="10 0 20">
      <joint name="lift" type="slide" axis="0 0 1" range="-0.1 0.4" ref="0.1"
        damping="30" frictionloss="12" armature="3"/>
      <inertial pos="0 0.02 0.1" mass="9" diaginertia="0.2 0.21 0.1"/>
      <body name="shoulder" pos="0.05 0 0.3" quat="0.9 0.1 0.2 0">
        <joint name="pan" axis="0 0 1" range="-150 150" ref="20" damping="2"/>
        <joint name="tilt" axis="0 1 0.2" pos="0.02 0 0.1" range="-90 90"/>
        <geom type="capsule" fromto="0 0 0 0.4 0 0.1" size="0.05"/>
        <body name="fore" pos="0.4 0 0.1">
          <joint name="elbow" axis="0 1 0" pos="0.01 0.02 0"/>
          <inertial pos="0.1 0 0" mass="2" fullinertia="0.01 0.03 0.03 0.002 0 0"/>
          <body name="f1" pos="0.2 0.02 0">
            <joint name="finger1" type="slide" axis="0 1 0" range="0 0.04"/>
            <geom size="0.02" mass="0.1"/>
          </body>
          <body name="f2" pos="0.2 -0.02 0">
            <joint name="finger2" type="slide" axis="0 -1 0" range="0 0.04"/>
            <geom size="0.02" mass="0.1"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <equality>
    <joint joint1="finger2" joint2="finger1" polycoef="0.01 1 0 0 0"/>
  </equality>
  <actuator>
    <motor joint="pan" gear="2" forcerange="-40 40" forcelimited="true"/>
  </actuator>
</mujoco>"""
ARM = ("lift", "pan", "tilt", "elbow")


def written(folder, text, name="arm.xml"):
    (folder / name).write_text(text)
    return folder / name


HELD = {
    "none": {},
    "some": {'"shoulder"': 'gravcomp="1"', '"fore"': 'gravcomp="0.4"'},
    # The drive of tilt counts what holds the bodies as its own torque.
    "counted": {'"fore"': 'gravcomp="0.7"', '"tilt"': 'actuatorgravcomp="true"'},
}


@pytest.mark.parametrize("held", HELD.values(), ids=HELD)
def test_an_mjcf_has_the_dynamics_that_mujoco_gives_it(tmp_path, held):
    text = MJCF
    for name, attribute in held.items():
        text = text.replace(f"name={name}", f"name={name} {attribute}")
    robot = load_arm(written(tmp_path, text))
    assert robot.joints == ARM
    assert robot.locked == {"finger1": 0, "finger2": pytest.approx(0.01)}
    model = mujoco.MjModel.from_xml_string(text)
    for part in ("dof_damping", "dof_frictionloss", "dof_armature"):
        getattr(model, part)[:] = 0
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    data, rng = mujoco.MjData(model), np.random.default_rng(1)
    states = rng.uniform(-0.8, 0.8, (3, 20, 4))
    ours = LazyRegressor(robot, tuple(states)) @ read_inertial_parameters(robot.model)
    for (q, qd, qdd), tau in zip(np.moveaxis(states, 1, 0), ours, strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:] = 0, 0, 0
        data.qpos[4:] = 0, 0.01
        data.qpos[:4], data.qvel[:4], data.qacc[:4] = q, qd, qdd
        mujoco.mj_inverse(model, data)
        np.testing.assert_allclose(tau, data.qfrc_inverse[:4], atol=1e-10)


def test_weight_that_is_held_beside_the_drives_is_said_and_may_be_denied(tmp_path):
    text = MJCF.replace('"fore"', '"fore" gravcomp="1"')
    robot = load_arm(written(tmp_path, text))
    assert robot.carried.links == ("fore",)
    assert any("gravcomp: the weight of fore" in note for note in robot.notes)
    again = build_robot(robot.name, robot.urdf, robot.toml)  # from what a store keeps
    np.testing.assert_array_equal(again.carried.shares, robot.carried.shares)
    with pytest.raises(RobotError, match="gravcomp = false"):
        write_urdf_with_inertias(robot, read_inertial_parameters(robot.model))
    (tmp_path / "robot.toml").write_text("[robot]\ngravcomp = false\n")
    assert load_arm(tmp_path).carried is None


def test_what_else_an_mjcf_says_is_declared(tmp_path):
    robot = load_arm(written(tmp_path, MJCF))
    values = {k: dict(d.values) for k, d in robot.declared.items()}
    np.testing.assert_array_equal(values["viscous"]["coefficient"], [30, 2, 0, 0])
    np.testing.assert_array_equal(values["coulomb"]["level"], [12, 0, 0, 0])
    np.testing.assert_array_equal(values["rotor_inertia"]["inertia"], [3, 0, 0, 0])
    assert all(declared.assumed for declared in robot.declared.values())
    np.testing.assert_allclose(robot.torque_limit, [np.inf, 80, np.inf, np.inf])
    np.testing.assert_allclose(robot.lower[:2], [-0.1, np.deg2rad(-150)])
    assert robot.upper[3] == np.inf
    assert load_robot(tmp_path / "arm.xml").declared == {}


def test_an_mjcf_that_does_not_compile_is_refused_in_mujocos_words(tmp_path):
    with pytest.raises(RobotError, match=r"does not compile arm.xml: .*mass"):
        load_arm(written(tmp_path, MJCF.replace('mass="9"', 'mass="-9"')))


XACRO = """<robot name="my arm" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:arg name="mass" default="2"/>
  <xacro:include filename="$(find parts)/link.xacro"/>
  <link name="base"/>
  <xacro:part name="a" parent="base" mass="$(arg mass)"/>
  <xacro:part name="b" parent="a" mass="1"/>
</robot>"""
PART = """<robot xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:macro name="part" params="name parent mass">
    <joint name="${name}_joint" type="revolute"><parent link="${parent}"/>
      <child link="${name}"/><origin xyz="0 0 0.3"/><axis xyz="0 1 0"/>
      <limit lower="${-pi/2}" upper="${pi/2}" velocity="2" effort="9"/></joint>
    <link name="${name}"><visual><geometry>
      <mesh filename="package://nowhere/${name}.stl"/></geometry></visual>
      <inertial><origin xyz="0.1 0 0"/><mass value="${mass}"/>
      <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>
    </link>
  </xacro:macro>
</robot>"""


@pytest.fixture
def xacro(tmp_path):
    pytest.importorskip("xacrodoc", reason="the extra xacro is not installed")
    (tmp_path / "elsewhere" / "parts").mkdir(parents=True)
    (tmp_path / "elsewhere" / "parts" / "link.xacro").write_text(PART)
    (tmp_path / "cell").mkdir()
    return written(tmp_path / "cell", XACRO, "arm.urdf.xacro")


def test_a_xacro_is_expanded_with_its_arguments_and_packages(xacro, tmp_path):
    dirs = [str(tmp_path / "elsewhere")]
    robot = load_arm(xacro, xacro_args=["mass:=7"], package_dirs=dirs)
    assert (robot.name, robot.joints) == ("my_arm", ("a_joint", "b_joint"))
    assert robot.model.inertias[1].mass == 7
    assert robot.upper[0] == pytest.approx(np.pi / 2)
    assert "package://nowhere" in robot.urdf  # meshes are nobody's concern
    word = f"{xacro}#arg=mass:=7&package={dirs[0]}"
    assert load_arm(word).content_hash == robot.content_hash
    (tmp_path / "elsewhere" / "parts").rename(tmp_path / "cell" / "parts")
    assert load_arm(xacro).model.inertias[1].mass == 2  # beside the file


def test_a_relative_include_of_a_xacro_begins_at_its_file(xacro, tmp_path, monkeypatch):
    (tmp_path / "cell" / "link.xacro").write_text(PART)
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "link.xacro").write_text("no XML")
    near = XACRO.replace("$(find parts)/", "")
    broken = written(tmp_path / "broken", near, "arm.urdf.xacro")
    written(tmp_path / "cell", near, "arm.urdf.xacro")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(RobotError, match="does not expand"):
        load_arm(broken)
    assert load_arm(xacro.relative_to(tmp_path)).joints == ("a_joint", "b_joint")


@pytest.mark.parametrize(
    ("args", "message"),
    [(["mass=7"], "expected name:=value"), ([], "arm.urdf.xacro does not expand.*parts")],
)
def test_a_xacro_that_does_not_expand_says_what_is_missing(xacro, args, message):
    with pytest.raises(InputError, match=message):
        load_arm(xacro, xacro_args=args)


@pytest.mark.parametrize(
    "more",
    ['<mujoco><compiler discardvisual="true"/></mujoco>', "<!-- converted for <mujoco> -->"],
    ids=["a block of MuJoCo's own", "a comment"],
)
def test_a_urdf_that_speaks_of_mujoco_is_a_urdf(more, tmp_path):
    folder = tmp_path / "arm.urdf"
    plain = urdf_text()
    folder.write_text(plain.replace("</robot>", f"{more}</robot>"), encoding="utf-8")
    other = tmp_path / "other.urdf"
    other.write_text(plain, encoding="utf-8")
    ours, theirs = load_robot(folder), load_robot(other)
    assert ours.declared == theirs.declared
    np.testing.assert_array_equal(ours.velocity_limit, theirs.velocity_limit)
