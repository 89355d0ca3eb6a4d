import numpy as np

from residual.robot.robot import load_robot
from sim.engine.geometry import build_arm_capsules, compute_clearances
from sim.engine.geometry import compute_capsule_ends as capsule_ends
from tests.sim.arms import TWO, arm

ROBOT = load_robot("irb140")


def test_capsules_run_between_the_frames_and_room_is_the_height_less_the_radius():
    irb = build_arm_capsules(ROBOT.model)
    ends = capsule_ends(irb, np.zeros((1, 6)))[0]
    expected = [(0, 0, 0), (0.07, 0, 0.352), (0.07, 0, 0.712), (0.45, 0, 0.712)]
    np.testing.assert_allclose(ends, [*expected, (0.515, 0, 0.712)], atol=1e-6)
    assert 0.07 < irb.radius < 0.09
    room = compute_clearances(irb, np.zeros((1, 6)))[0]
    heights = dict(zip(irb.names, room, strict=True))
    assert abs(heights["the flange above the floor"] - (0.712 - irb.radius)) < 1e-6


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


def test_no_floor_is_known_where_the_first_axis_is_level(tmp_path):
    two = build_arm_capsules(arm(TWO, tmp_path).model)
    assert two.low == ()
    assert compute_clearances(two, np.zeros((4, 2))).shape == (4, len(two.pairs))
