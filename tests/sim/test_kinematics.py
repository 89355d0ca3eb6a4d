import numpy as np
import pinocchio as pin
import pytest

from residual.robot.robot import load_robot
from sim.engine.geometry import (
    build_tool_kinematics,
    measure_singularity_distance,
    solve_inverse_kinematics,
    solve_pose_path,
)
from sim.engine.geometry import compute_flange_pose as pose
from sim.engine.plant_records import TrajectorySpec
from sim.trajectories import plan_reference_motion
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


def test_painting_stays_in_the_plane_of_the_panel():
    r = plan_reference_motion(ROBOT, TrajectorySpec("cyclic", seed=3), 50.0)
    points = np.array([pose(IRB, q).translation for q in r.q])
    flat = points - points.mean(axis=0)
    values = np.linalg.svd(flat, compute_uv=False) / np.sqrt(len(flat))
    assert values[2] < 1e-6
    assert values[1] > 0.02


def test_seams_are_straight_and_even():
    r = plan_reference_motion(ROBOT, TrajectorySpec("welding", seed=3), 250.0)
    points = np.array([pose(IRB, q).translation for q in r.q])
    speed = np.linalg.norm(np.diff(points, axis=0), axis=1) * 250.0
    still = np.flatnonzero((r.qd == 0).all(axis=1))
    # From the end of the first dwell to the beginning of the second: the first seam.
    first = still[np.flatnonzero(np.diff(still) > 1)[0]]
    last = still[np.flatnonzero(np.diff(still) > 1)[0] + 1]
    seam = points[first : last + 1]
    way = (seam[-1] - seam[0]) / np.linalg.norm(seam[-1] - seam[0])
    off = (seam - seam[0]) - np.outer((seam - seam[0]) @ way, way)
    assert np.abs(off).max() < 1e-6
    middle = speed[first + (last - first) // 3 : last - (last - first) // 3]
    assert np.ptp(middle) < 1e-3 * middle.mean()
