"""Motions of every family: limits, rest, repeats; kinematics and the search behind them."""

from functools import lru_cache

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from residual.errors import InputError
from residual.robot.dynamics import compute_inverse_dynamics
from residual.robot.robot import load_robot
from sim.engine.geometry import (
    MARGIN,
    build_arm_capsules,
    build_tool_kinematics,
    compute_clearances,
    compute_flange_pose,
    measure_singularity_distance,
    solve_inverse_kinematics,
    solve_pose_path,
)
from sim.engine.geometry import compute_capsule_ends as capsule_ends
from sim.engine.plant_records import TrajectorySpec
from sim.trajectories import (
    KINDS,
    MotionLimitError,
    plan_motion,
    plan_reference_motion,
    sample_plan,
)
from sim.trajectories import excitation as search
from sim.trajectories.excitation import (
    build_excitation_problem,
    compute_limit_usage,
    measure_excitation,
)
from sim.trajectories.excitation import draw_feasible_series as feasible_series
from sim.trajectories.planning_limits import (
    build_workspace,
    check_motion_limits,
    read_planning_limits,
)
from sim.trajectories.planning_limits import check_motion_clearance as check_clearance

# Arms to plan for, as URDF text.


def _link(name, mass, inertia, centre):
    x, y, z = centre
    return (
        f'<link name="{name}"><inertial><origin xyz="{x} {y} {z}"/>'
        f'<mass value="{mass}"/><inertia ixx="{inertia}" iyy="{inertia}" '
        f'izz="{inertia / 2}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )


def _joint(number, parent, child, place, axis, effort):
    return (
        f'<joint name="j{number}" type="revolute"><parent link="{parent}"/>'
        f'<child link="{child}"/><origin xyz="{place}"/><axis xyz="{axis}"/>'
        f'<limit lower="-2.8" upper="2.8" velocity="2.5" effort="{effort}"/></joint>'
    )


def urdf(name, places, axes, masses, efforts):
    text, parent = f'<robot name="{name}"><link name="l0"/>', "l0"
    for i, place in enumerate(places, start=1):
        mass = masses[i - 1]
        text += _link(f"l{i}", mass, 0.02 * mass, (0.01, 0.02, 0.1))
        text += _joint(i, parent, f"l{i}", place, axes[i - 1], efforts[i - 1])
        parent = f"l{i}"
    text += f'<link name="tip"/><joint name="end" type="fixed"><parent link="{parent}"/>'
    return text + '<child link="tip"/><origin xyz="0 0 0.1"/></joint></robot>'


Z, Y = "0 0 1", "0 1 0"
MASSES = [6, 3, 2, 1.5, 1.2, 1, 0.8]
SEVEN = urdf("seven", ["0 0 0.2"] * 7, [Z, Y, Z, Y, Z, Y, Z], MASSES, [80] * 7)
# A pendulum of two links: a first axis that is level, so no floor is known.
TWO = urdf("two", ["0 0 0.3", "0 0 0.4"], [Y, Y], [3, 2], [60, 40])
# At zero it lies along the floor, a hand above it.
FLAT = urdf(
    "flat",
    ["0 0 0.1", "0 0.1 0", "0.4 -0.1 0", "0.4 0 0", "0 0.1 0", "0.1 0 0"],
    [Z, Y, Y, Y, Z, Y],
    [8, 8, 3, 1.3, 1.2, 0.3],
    [150, 150, 150, 28, 28, 28],
)


def arm(text, folder):
    path = folder / "arm.urdf"
    path.write_text(text)
    return load_robot(path)


# Motions of every family: limits, rest, repeats; kinematics and the search behind them.


ROBOT = load_robot("irb140")


@pytest.mark.parametrize("size", [0.7, 1.6], ids=["within limits", "beyond them"])
def test_slopes_of_the_search_are_derivatives(size):
    place = build_workspace(ROBOT, 8.0)
    search = build_excitation_problem(place)
    x = size * search.encode_series(feasible_series(place, np.random.default_rng(1)))
    way, step = np.random.default_rng(2).normal(size=x.shape), 1e-6
    ahead, back = x + step * way, x - step * way
    slope = (search.cost(ahead)[0] - search.cost(back)[0]) / (2 * step)
    assert search.cost(x)[1] @ way == pytest.approx(slope, rel=1e-4)
    change = (search.compute_margins(ahead) - search.compute_margins(back)) / (2 * step)
    assert_allclose(search.compute_margin_gradients(x) @ way, change, atol=1e-6)


IRB = build_tool_kinematics(ROBOT, "test")


@pytest.mark.parametrize("seed", range(2))
def test_the_flange_comes_where_it_was_sent(seed):
    rng = np.random.default_rng(seed)
    q = rng.uniform(-1, 1, 6)
    target = compute_flange_pose(IRB, q)
    q_found = solve_inverse_kinematics(IRB, target, q + rng.uniform(-0.2, 0.2, 6))
    assert q_found is not None
    assert np.abs(pin.log6(compute_flange_pose(IRB, q_found).actInv(target)).vector).max() < 1e-9


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
    start = compute_flange_pose(seven, home)
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


# Every family on the built-in arm: limits, rest, repeats, sameness.


LIMITS = read_planning_limits(ROBOT)
DURATION = 12.0  # s, two periods


@pytest.fixture(autouse=True)
def short_search(monkeypatch):
    """The search goes on for longer; what is asked here holds at any step of it."""
    monkeypatch.setattr(search, "_STEPS", (10, 20))


@lru_cache
def plan(kind):
    return plan_motion(ROBOT, TrajectorySpec(kind, DURATION, seed=1))


def reference(kind, rate=1000.0):
    return sample_plan(plan(kind), rate)


@pytest.mark.parametrize("kind", KINDS)
def test_limits_hold_between_the_samples(kind):
    # Planned at 1 kHz, looked at where nobody looked before.
    dense = reference(kind, 3300.0)
    assert (dense.q >= LIMITS.lower).all()
    assert (dense.q <= LIMITS.upper).all()
    assert (np.abs(dense.qd) <= LIMITS.velocity).all()
    assert (np.abs(dense.qdd) <= LIMITS.acceleration).all()
    # They leave the controller some of the arm's own.
    assert (LIMITS.velocity <= 0.8 * ROBOT.velocity_limit).all()
    assert (LIMITS.acceleration <= 0.9 * ROBOT.acceleration_limit).all()
    declared = ROBOT.declared
    torque = compute_inverse_dynamics(ROBOT.model, dense.q, dense.qd, dense.qdd)
    torque += declared["rotor_inertia"].values["inertia"] * dense.qdd
    torque += declared["viscous"].values["coefficient"] * dense.qd
    torque += declared["coulomb"].values["level"] * np.sign(dense.qd)
    assert (np.abs(torque) <= LIMITS.torque).all()


@pytest.mark.parametrize("kind", KINDS)
def test_a_motion_stays_clear_is_smooth_and_rests_at_both_ends(kind):
    r = reference(kind)
    assert compute_clearances(build_arm_capsules(ROBOT.model), r.q[::7]).min() >= MARGIN
    h = r.t[1] - r.t[0]
    qd = (r.q[2:] - r.q[:-2]) / (2 * h)
    qdd = (r.qd[2:] - r.qd[:-2]) / (2 * h)
    np.testing.assert_allclose(qd, r.qd[1:-1], atol=1e-3)
    # The jerk of a quintic move jumps where it begins.
    assert np.quantile(np.abs(qdd - r.qdd[1:-1]), 0.99) < 2e-2
    np.testing.assert_allclose(qdd, r.qdd[1:-1], atol=0.3)
    assert (r.t[0], r.t[-1]) == (0, DURATION)
    assert np.abs(r.qd[[0, -1]]).max() < 1e-10
    assert np.abs(r.qdd[[0, -1]]).max() < 1e-9


@pytest.mark.parametrize("kind", KINDS)
def test_periods_repeat(kind):
    r = reference(kind)
    ramp = 1.0 if kind == "cyclic" else 0.0
    assert r.period == pytest.approx((DURATION - ramp) / 2)
    # Shifted by one period, away from where a cyclic motion starts and stops.
    inner = (r.t > ramp) & (r.t < DURATION - ramp - r.period)
    for values in (r.q, r.qd):
        shifted = [np.interp(r.t[inner] + r.period, r.t, v) for v in values.T]
        np.testing.assert_allclose(np.transpose(shifted), values[inner], atol=2e-5)


@pytest.mark.parametrize("kind", ["fourier", "move_stop_move"])
def test_the_same_spec_gives_the_same_bits_and_another_seed_another_motion(kind):
    again = plan_reference_motion(ROBOT, TrajectorySpec(kind, DURATION, seed=1), 1000.0)
    for name in ("t", "q", "qd", "qdd"):
        one, two = (getattr(x, name).tobytes() for x in (again, reference(kind)))
        assert one == two
    spec = TrajectorySpec(kind, DURATION, seed=2)
    other = plan_reference_motion(ROBOT, spec, 50.0, optimised=False)
    assert np.abs(other.q - reference(kind, 50.0).q).max() > 0.05


def test_pick_and_place_really_dwells():
    r = reference("move_stop_move")
    still = (r.qd == 0).all(axis=1)
    assert 0.15 < still.mean() < 0.7
    assert (np.diff(still.astype(int)) == 1).sum() >= 6
    # Nothing but rest between its ends, to the last bit.
    assert np.ptp(r.q[np.flatnonzero(still)[:200]], axis=0).max() == 0


def flange_points(kind, rate):
    tool = build_tool_kinematics(ROBOT, "test")
    q = reference(kind, rate).q
    return np.array([compute_flange_pose(tool, row).translation for row in q])


def test_painting_stays_in_the_plane_of_the_panel():
    points = flange_points("cyclic", 50.0)
    flat = points - points.mean(axis=0)
    values = np.linalg.svd(flat, compute_uv=False) / np.sqrt(len(flat))
    assert values[2] < 1e-6
    assert values[1] > 0.02


def test_seams_are_straight_and_even():
    points = flange_points("welding", 250.0)
    speed = np.linalg.norm(np.diff(points, axis=0), axis=1) * 250.0
    still = np.flatnonzero((reference("welding", 250.0).qd == 0).all(axis=1))
    # From the end of the first dwell to the beginning of the second: the first seam.
    first = still[np.flatnonzero(np.diff(still) > 1)[0]]
    last = still[np.flatnonzero(np.diff(still) > 1)[0] + 1]
    seam = points[first : last + 1]
    way = (seam[-1] - seam[0]) / np.linalg.norm(seam[-1] - seam[0])
    off = (seam - seam[0]) - np.outer((seam - seam[0]) @ way, way)
    assert np.abs(off).max() < 1e-6
    middle = speed[first + (last - first) // 3 : last - (last - first) // 3]
    assert np.ptp(middle) < 1e-3 * middle.mean()


PLACES = ((0.0, -0.6, 0.3, 0.0, 0.5, 0.0), (0.8, -0.2, -0.2, 0.4, -0.5, 1.0))


def going_round(duration, rounds, places=PLACES):
    return TrajectorySpec("move_stop_move", duration, rounds, 0, places)


def test_given_places_are_gone_round_after_a_stand_that_fills_the_time():
    plan_ = plan_motion(ROBOT, going_round(8.0, 3))
    stand = 8.0 - 3 * plan_.period
    assert stand > 0
    q, qd, _ = plan_.curve(np.linspace(0, stand, 50))
    assert (q == np.array(PLACES[0])).all()
    assert (qd == 0).all()
    rounds = [plan_.curve(stand + plan_.period * (n + 0.3) * np.ones(1))[0] for n in (0, 2)]
    np.testing.assert_allclose(*rounds, atol=1e-9)
    np.testing.assert_allclose(plan_.curve(np.array([8.0]))[0][0], PLACES[0], atol=1e-9)


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        (going_round(8.0, 12), "12 rounds of .* do not fit into 8 s"),
        (going_round(8.0, 1, PLACES[:1]), "expected 2 or more places of 6 angles, got 1"),
        (going_round(8.0, 1, ((0.0,), (1.0,))), r"got 2 of \[1\]"),
        (going_round(8.0, 1, (PLACES[0], (np.nan, *PLACES[1][1:]))), "finite numbers"),
        (TrajectorySpec("welding", 8.0, 1, 0, PLACES), "welding has no coefficients"),
    ],
)
def test_places_that_cannot_be_gone_round_are_refused(spec, message):
    with pytest.raises(InputError, match=message):
        plan_motion(ROBOT, spec)


# Other arms than the built-in one, and specifications that cannot be met.


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
    r, limits = plan_reference_motion(robot, spec, 100.0, False), read_planning_limits(robot)
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
    limit = read_planning_limits(ROBOT).velocity[0]
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
