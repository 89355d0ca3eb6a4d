"""Other arms than the built-in one, and specifications that cannot be met."""

import numpy as np
import pytest

from residual.errors import InputError
from residual.robot.robot import load_robot
from sim.engine.geometry import MARGIN, build_arm_capsules, compute_clearances
from sim.engine.plant_records import TrajectorySpec
from sim.trajectories import KINDS, MotionLimitError, plan_reference_motion
from sim.trajectories import excitation as search
from sim.trajectories.excitation import compute_limit_usage, measure_excitation
from sim.trajectories.planning_limits import check_motion_clearance as check_clearance
from sim.trajectories.planning_limits import check_motion_limits
from sim.trajectories.planning_limits import read_planning_limits as read_limits
from tests.sim.arms import FLAT, SEVEN, TWO, arm

ROBOT = load_robot("irb140")
POSES = ("cyclic", "welding")


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        *((FLAT, kind) for kind in KINDS if kind != "fourier"),
        pytest.param(FLAT, "fourier", marks=pytest.mark.long),
        *(pytest.param(SEVEN, kind, marks=pytest.mark.long) for kind in KINDS),
    ],
)
def test_families_plan_for_other_arms(text, kind, tmp_path):
    robot, spec = arm(text, tmp_path), TrajectorySpec(kind, 11.0, 1)
    r, limits = plan_reference_motion(robot, spec, 100.0, False), read_limits(robot)
    assert ((r.q >= limits.lower) & (r.q <= limits.upper)).all()
    assert (np.abs(r.qd) <= limits.velocity).all()
    assert compute_clearances(build_arm_capsules(robot.model), r.q).min() >= MARGIN
    assert np.ptp(r.q, axis=0).min() > 0.01


def test_two_joints_are_enough_for_joint_motions(tmp_path):
    robot = arm(TWO, tmp_path)
    for kind in ("fourier", "move_stop_move"):
        r = plan_reference_motion(robot, TrajectorySpec(kind, 8.0, 1), 200.0)
        assert r.q.shape == (1601, 2)
    shares = compute_limit_usage(robot, r)
    assert np.isnan(shares.acceleration).all()
    assert (shares.torque < 0.85).all()


@pytest.mark.parametrize("kind", POSES)
def test_poses_in_space_need_six_joints(kind, tmp_path):
    with pytest.raises(InputError, match=r"needs 6 joints, two has 2.*move_stop_move"):
        plan_reference_motion(arm(TWO, tmp_path), TrajectorySpec(kind), 200.0)


@pytest.mark.parametrize(
    "kind", ["move_stop_move", *(pytest.param(k, marks=pytest.mark.long) for k in POSES)]
)
def test_a_motion_that_is_too_fast_says_which_joint_when_and_by_how_much(kind):
    with pytest.raises(MotionLimitError) as caught:
        plan_reference_motion(ROBOT, TrajectorySpec(kind, 2.4, 2), 200.0)
    error = caught.value
    assert 1 <= error.joint <= 6
    assert 0 <= error.time <= 2.4
    assert error.value > error.limit > 0
    text = str(error)
    assert f"joint {error.joint} breaks its" in text
    assert f"{error.time:.2f} s" in text
    assert "too much" in text
    assert "times as long" in text


@pytest.mark.parametrize(
    ("spec", "rate", "words"),
    [
        (TrajectorySpec("weldin"), 250.0, "did you mean 'welding'"),
        (TrajectorySpec(duration=0.0), 250.0, "duration must be above 0"),
        (TrajectorySpec(duration=float("nan")), 250.0, "duration must be above 0"),
        (TrajectorySpec(periods=0), 250.0, "periods must be 1 or more"),
        (TrajectorySpec(periods=100), 250.0, "expected 50 s or more"),
        (TrajectorySpec("cyclic", 1.5, 1), 250.0, "expected 2 s or more"),
        (TrajectorySpec(seed=-1), 250.0, "seed must be 0 or more"),
        (TrajectorySpec(), 0.0, "rate must be"),
    ],
)
def test_nonsense_is_refused_with_what_was_expected(spec, rate, words):
    with pytest.raises(InputError, match=words):
        plan_reference_motion(ROBOT, spec, rate)


def test_too_much_torque_is_named(tmp_path):
    weak = arm(TWO.replace('effort="60"', 'effort="15"'), tmp_path)
    motion = np.zeros((3, 20, 2))
    motion[0, :, 0] = np.pi / 2  # held out level
    with pytest.raises(MotionLimitError, match="joint 1 breaks its torque limit") as caught:
        check_motion_limits(weak, "test", np.arange(20) / 100, tuple(motion))
    assert caught.value.limit == pytest.approx(12.0)


def test_a_peak_between_two_samples_is_seen():
    t = np.arange(101) / 100
    limit = read_limits(ROBOT).velocity[0]
    # A wave whose samples miss its peaks.
    wave = np.cos(2 * np.pi * 10 * t + np.pi / 10)
    qd = np.zeros((101, 6))
    qd[:, 0] = wave / wave.max() * 0.999 * limit
    still = np.zeros((101, 6))
    with pytest.raises(MotionLimitError, match="joint 1 breaks its speed limit"):
        check_motion_limits(ROBOT, "test", t, (still, qd, still))


def test_an_arm_that_reaches_into_the_floor_or_folds_onto_itself_is_told():
    arm_body = build_arm_capsules(ROBOT.model)
    q = np.zeros((20, 6))
    q[:, 1] = np.linspace(0, 1.9, 20)
    with pytest.raises(MotionLimitError, match=r"above the floor is -\d+ mm") as caught:
        check_clearance(arm_body, "test", np.arange(20) / 10, q)
    assert caught.value.value < MARGIN
    q = np.zeros((5, 6))
    q[:, 1], q[:, 2] = -1.5, -3.9
    with pytest.raises(MotionLimitError, match="joint 4"):
        check_clearance(build_arm_capsules(ROBOT.model), "test", np.arange(5) / 10, q)


@pytest.mark.long
def test_the_search_improves_an_arm_with_seven_joints(tmp_path, monkeypatch):
    monkeypatch.setattr(search, "_STEPS", (10, 20))  # enough for what is asked below
    robot = arm(SEVEN, tmp_path)
    references = [
        plan_reference_motion(robot, TrajectorySpec(), 100.0, optimised)
        for optimised in (False, True)
    ]
    worse, better = (measure_excitation(robot.model, r.q, r.qd, r.qdd) for r in references)
    assert better.condition < 0.6 * worse.condition
