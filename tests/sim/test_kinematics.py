import numpy as np
import pinocchio as pin
import pytest

from residual.robot.robot import load_robot
from sim.engine.geometry import (
    build_arm_capsules,
    build_tool_kinematics,
    compute_clearances,
    measure_singularity_distance,
    solve_inverse_kinematics,
    solve_pose_path,
)
from sim.engine.geometry import compute_capsule_ends as capsule_ends
from sim.engine.geometry import compute_flange_pose as pose
from tests.sim.arms import SEVEN, arm

ROBOT = load_robot("irb140")
IRB = build_tool_kinematics(ROBOT, "test")


@pytest.mark.parametrize("seed", range(2))
def test_the_flange_comes_where_it_was_sent(seed):
    rng = np.random.default_rng(seed)
    q = rng.uniform(-1, 1, 6)
    target = pose(IRB, q)
    q_found = solve_inverse_kinematics(IRB, target, q + rng.uniform(-0.2, 0.2, 6))
    assert q_found is not None
    assert np.abs(pin.log6(pose(IRB, q_found).actInv(target)).vector).max() < 1e-9


def test_what_is_out_of_reach_is_not_found_and_a_stretched_wrist_is_singular():
    far = pin.SE3(np.eye(3), np.array([2.0, 0, 0.5]))
    assert solve_inverse_kinematics(IRB, far, np.full(6, 0.3)) is None
    straight, bent = np.full((2, 6), 0.3)
    straight[4], bent[4] = 0.0, 1.0
    values = measure_singularity_distance(IRB, np.array([straight, bent]))
    assert values[0] < 1e-9
    assert values[1] > 0.05


def test_a_spare_joint_comes_home_with_the_flange(tmp_path):
    seven = build_tool_kinematics(arm(SEVEN, tmp_path), "test")
    home = np.array([0.2, 0.8, -0.3, 1.0, 0.4, 0.9, 0.1])
    start = pose(seven, home)
    angle = np.linspace(0, 2 * np.pi, 40)
    targets = [
        pin.SE3(start.rotation, start.translation + 0.1 * np.array([0, np.sin(a), 0]))
        for a in angle
    ]
    q = solve_pose_path(seven, targets, home, home)
    np.testing.assert_allclose(q[0], q[-1], atol=1e-9)
    assert np.abs(q[10] - q[0]).max() > 0.02


def test_distances_of_capsules_are_those_of_their_axes():
    irb = build_arm_capsules(ROBOT.model)
    q = np.random.default_rng(2).uniform(-2, 2, (10, 6))
    room, ends = compute_clearances(irb, q), capsule_ends(irb, q)
    x = np.linspace(0, 1, 300)[:, None, None]
    for check, (i, j) in enumerate(irb.pairs, start=len(irb.low)):
        a = ends[:, i] + x * (ends[:, i + 1] - ends[:, i])
        b = ends[:, j] + x * (ends[:, j + 1] - ends[:, j])
        apart = np.linalg.norm(a[:, None] - b[None], axis=-1).min(axis=(0, 1))
        np.testing.assert_allclose(room[:, check] + 2 * irb.radius, apart, atol=3e-3)
