"""Every family on the built-in arm: limits, rest, repeats, sameness."""

from functools import lru_cache

import numpy as np
import pytest

from residual.errors import InputError
from residual.robot.dynamics import compute_inverse_dynamics
from residual.robot.robot import load_robot
from sim.engine.geometry import (
    MARGIN,
    build_arm_capsules,
    build_tool_kinematics,
    compute_clearances,
    compute_flange_pose,
)
from sim.engine.plant_records import TrajectorySpec
from sim.trajectories import KINDS, plan_motion, plan_reference_motion, sample_plan
from sim.trajectories import excitation as search
from sim.trajectories.planning_limits import read_planning_limits

ROBOT = load_robot("irb140")
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
