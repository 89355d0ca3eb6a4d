"""What something else explains is never a certain fault of the log."""

import re
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.check_parts.arms import SEVEN, SIX, host
from benchmarks.check_parts.explained import EXPLAINED
from benchmarks.check_parts.file_flaws import draw_flawed, scale_masses
from benchmarks.check_parts.judge import given_robot
from residual.check.check import check_logs
from residual.check.evidence import NominalShares
from residual.check.slips import build_order_slip, build_sign_slips, list_factor_slips, merge_slips
from sim.engine.plant_records import create_random_stream
from tests.residual.arms import arm
from tests.residual.check.damaged import AXES, clean_logs, edited, swapped, times


def two_logs(name, seed=1):
    hosted = host(name, seed)
    return replace(hosted, logs=hosted.logs[:2])


def check_explained(name, kind, size, seed=1):
    """Return what the check says of a case of the benchmark, and the case."""
    hosted = two_logs(name, seed)
    rng = create_random_stream(seed, f"fault/{name}/{kind}/{size}")
    case = EXPLAINED[kind](hosted, size, rng)
    logs = [replace(r, **t) for r, t in zip(hosted.logs, case.tables, strict=True)]
    return check_logs(given_robot(hosted, case), logs).faults, case


@pytest.mark.parametrize(("name", "kind"), [(SIX, "bodies"), (SEVEN, "balanced"), (SIX, "gain")])
def test_flaws_of_the_file_and_balanced_arms_are_no_certain_fault(name, kind):
    if kind == "bodies":
        hosted, rng = two_logs(name), create_random_stream(1, f"bodies/{name}")
        flawed = draw_flawed(hosted, rng)
        faults = check_logs(flawed.robot, hosted.logs).faults
    else:
        faults, _ = check_explained(name, kind, 2)
    assert not [f for f in faults if f.certain]
    assert not [f for f in faults if f.kind == "mounting"]


@pytest.mark.parametrize(
    ("name", "size"), [(SIX, 0), pytest.param(SEVEN, 2, marks=pytest.mark.long)]
)
def test_a_zero_that_is_off_by_quarter_turns_has_its_joint_and_line(name, size):
    faults, case = check_explained(name, "zero", size)
    (fault,) = [f for f in faults if f.kind == "angle_zero"]
    assert fault.joints == case.joints
    off = (np.pi / 2, -np.pi / 2, np.pi)[size]
    assert fault.repairs[0].zero == pytest.approx((off,))


def test_a_zero_near_a_quarter_turn_is_not_taken_for_one():
    robot, logs = clean_logs("small")
    off = np.array([0, 1.45, 0])
    (fault,) = check_logs(robot, edited(logs, q=lambda q: q + off)).faults
    assert (fault.kind, fault.joints, fault.certain) == ("angle_zero", (2,), False)
    about = re.search(r"about (\d+) degrees", fault.evidence)
    assert float(about[1]) == pytest.approx(np.degrees(1.45), abs=2)
    assert not fault.repairs  # too rough to be a line


def test_two_mistakes_are_found_where_the_file_bends_as_far_beside_one():
    robot, logs = clean_logs("small")
    both = edited(logs, q=lambda q: np.rad2deg(swapped(1, 2)(q)), tau=swapped(1, 2))
    faults = check_logs(robot, both).faults
    assert {(f.kind, f.joints) for f in faults} == {("joint_order", (1, 2)), ("angle_unit", ())}


def test_factors_of_all_drives_are_not_asked_for_beside_one_in_its_unit():
    known = {"ratio_sd": np.full(3, 0.01), "explained": np.ones(3)}
    load = np.array([4.0, 64, 14])  # joint 1 turns about the vertical
    robot, _ = clean_logs("small")
    for first, counts in ((1.0, {1}), (0.2, {1, 3})):
        ratio = np.array([first, 0.4, 0.3])
        shares = NominalShares(ratio=ratio, load=load, **known)
        scales = [s.repairs[0].scale for s in list_factor_slips(robot, shares)]
        assert {len(set(np.ravel(scale))) for scale in scales} == counts


@pytest.mark.parametrize(("name", "factor"), [(SIX, 3.5), (SEVEN, 0.4)])
def test_masses_of_another_scale_are_one_of_two_readings(name, factor):
    hosted = two_logs(name)
    (fault,) = check_logs(scale_masses(hosted.robot, factor), hosted.logs).faults
    assert (fault.kind, fault.certain) == ("torque_unit", False)
    assert "masses of the robot file" in fault.rivals[0]
    assert "known mass" in fault.settle


def test_a_torque_factor_is_named_where_the_weight_shows_it():
    faults, case = check_explained(SIX, "gain", 0)
    (fault,) = [f for f in faults if f.kind == "torque_scale"]
    assert fault.joints == case.joints
    assert not fault.certain


def test_placeholder_inertias_are_no_clock():
    _, logs = clean_logs("small")
    robot = arm(AXES)
    for body in robot.model.inertias[1:]:
        body.inertia = np.eye(3)
    kinds = [(f.kind, f.certain) for f in check_logs(robot, logs).faults]
    assert ("time_unit", True) not in kinds
    speeds = [replace(r, qd=np.gradient(r.q, r.t, axis=0)) for r in logs]
    assert "time_unit" not in [f.kind for f in check_logs(robot, speeds).faults]


def test_counts_of_a_drive_with_two_signs_are_no_other_robot():
    robot, logs = clean_logs("irb140")
    counts = np.array([29.0, 28.0, 30.0, -74.0, -74.0, 74.0])
    faults = check_logs(robot, edited(logs, tau=times(counts))).faults
    assert {f.kind for f in faults} <= {"torque_unit", "torque_sign"}
    assert "torque_unit" in {f.kind for f in faults}


def test_the_speeds_of_an_angle_with_another_zero_stay_as_they_are():
    robot, logs = clean_logs("small")
    both = [replace(r, qd=np.gradient(r.q, r.t, axis=0)) for r in logs]
    off = np.array([0, np.pi / 2, 0])
    faults = check_logs(robot, edited(both, q=lambda q: q + off)).faults
    (fault,) = [f for f in faults if f.kind == "angle_zero"]
    assert [repair.signal for repair in fault.repairs] == ["q"]


@pytest.mark.long
def test_angles_of_all_joints_that_count_backwards_are_no_turned_torques():
    hosted = host(SEVEN, 1)
    faults = check_logs(hosted.robot, edited(hosted.logs, q=lambda q: -q)).faults
    assert [(f.kind, len(f.joints)) for f in faults] == [("angle_sign", 7)]


@pytest.mark.long
def test_two_turned_angles_are_not_their_mirror_image():
    hosted = host(SEVEN, 1)
    sign = np.array([1, 1, -1, 1, -1, 1, 1])
    faults = check_logs(hosted.robot, edited(hosted.logs, q=times(sign))).faults
    assert [(f.kind, f.joints, f.certain) for f in faults] == [("angle_sign", (3, 5), True)]


def test_three_joints_in_a_ring_are_one_order():
    robot, logs = clean_logs("irb140")
    ring = np.array([2, 1, 4, 3, 0, 5])  # joints 1, 3, 5
    bad = edited(logs, q=lambda q: q[:, ring], tau=lambda tau: tau[:, ring])
    (fault,) = check_logs(robot, bad).faults
    assert (fault.kind, fault.joints) == ("joint_order", (1, 3, 5))
    assert {repair.order for repair in fault.repairs} == {(5, 2, 1, 4, 3, 6)}


def test_signs_before_an_exchange_of_channels_are_signs_of_joints_behind_it():
    before = build_sign_slips(set(), {3}, 6)
    order = build_order_slip((0, 1, 3, 2, 4, 5), ("q", "tau"))
    moved, sign = merge_slips([*before, order], 6)
    assert (moved, sign.kind, sign.joints) == (order, "torque_sign", (4,))


def test_a_turned_torque_that_may_be_a_turned_angle_is_one_fault_with_both_lines():
    """A wrist's hand weighs little: its friction alone shows which way it turns."""
    hosted = two_logs(SIX)
    sign = np.array([1, 1, 1, 1, -1, 1])
    (fault,) = check_logs(hosted.robot, edited(hosted.logs, tau=times(sign))).faults
    assert (fault.kind, fault.joints, fault.rivals) == ("torque_sign", (5,), ())
    assert [r.signal for r in (*fault.repairs, *fault.alternatives[0])] == ["tau", "q"]
