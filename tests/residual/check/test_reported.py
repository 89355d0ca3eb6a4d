"""Faults of logs: which are certain, and what is reported of them."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from benchmarks.check_parts.arms import SEVEN, SIX, host
from benchmarks.check_parts.explained import EXPLAINED
from benchmarks.check_parts.file_flaws import draw_flawed, scale_masses
from benchmarks.check_parts.judge import given_robot
from flows.steps.check import format_repair_lines
from residual.check.check import check_logs, find_insufficient_motion
from residual.check.evidence import NominalShares, filter_check_motion
from residual.check.gravcomp import find_weight_in_torque
from residual.check.kinematics import find_limit_violations
from residual.check.result import Repair
from residual.check.slips import build_order_slip, build_sign_slips, list_factor_slips, merge_slips
from residual.robot.dynamics import compute_gravity_torque, compute_inverse_dynamics
from residual.robot.plausibility import CarriedWeight
from residual.robot.robot import load_robot
from residual.signals.filters import filter_low_pass
from sim.engine.plant_records import create_random_stream
from tests.residual.arms import arm, plain_logs
from tests.residual.check.damaged import AXES, clean_logs, edited, kinds, swapped, times
from warehouse.logs import read_log
from warehouse.logs.column_map import ColumnMap

# What something else explains is never a certain fault of the log.


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
        flawed, _ = draw_flawed(hosted, rng)
        faults = check_logs(flawed, hosted.logs).faults
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


# Torque in another unit, without weight or friction, or computed: told, and why.


EXAMPLE = Path(__file__).parents[3] / "examples" / "hidden"
DOWN = np.array([0, 0, -9.81])  # m/s^2
CONSTANTS = np.array([8.0, 15.0, 10.0, 12.0, 9.0, 14.0])  # N m per logged A


@pytest.fixture(scope="module")
def example():
    robot = load_robot("irb140")
    return robot, [read_log(str(EXAMPLE / f"fit_{k}.csv"), robot)[0] for k in (1, 2, 3)]


@pytest.mark.parametrize("loaded", [True, pytest.param(False, marks=pytest.mark.long)])
def test_currents_are_told_with_the_factor_of_each_joint(example, loaded):
    # The example has a load that its robot file lacks: factors come out too small.
    robot, logs = (example[0], example[1][1:]) if loaded else clean_logs("irb140")
    (fault,) = check_logs(robot, edited(logs[:2], tau=times(1 / CONSTANTS))).faults
    assert (fault.kind, fault.joints, fault.certain) == ("torque_unit", (), True)
    assert "torque_per_unit" in fault.evidence
    assert not fault.repairs  # factors by the masses of a file are too rough for a line
    for joint, factor in ((1, 8), (2, 15), (3, 10))[: 2 if loaded else 3]:
        before, _ = fault.evidence.split(f" (joint {joint})")
        away = np.log(float(before.split()[-1]) / factor)
        assert -1.3 < away < 0.15 if loaded else abs(away) < 0.15


def test_currents_are_mended_by_the_constants_of_the_robot_file():
    robot, logs = clean_logs("irb140")
    amperes = edited(logs, tau=times(1 / CONSTANTS))
    (fault,) = check_logs(replace(robot, torque_per_unit=CONSTANTS), amperes).faults
    scale = tuple(CONSTANTS.tolist())
    assert fault.repairs == (Repair("tau", (1, 2, 3, 4, 5, 6), scale=scale),)


def test_one_factor_for_all_is_told_as_one():
    robot, logs = clean_logs("small")
    (fault,) = check_logs(robot, edited(logs, tau=times(1 / 12))).faults
    assert (fault.kind, fault.certain) == ("torque_unit", True)
    (number,) = re.findall(r"times about ([\d.]+\d):", fault.evidence)
    assert float(number) == pytest.approx(12, rel=0.05)


def test_a_unit_that_has_a_name_has_its_line():
    robot, logs = clean_logs("small")
    (fault,) = check_logs(robot, edited(logs, tau=times(10.1972))).faults  # kgf cm
    assert (fault.kind, fault.certain) == ("torque_unit", True)
    assert fault.repairs == (Repair("tau", scale=0.0980665),)


def without_weight(robot, logs, share=1.0):
    down = robot.model.gravity.linear
    return [
        replace(r, tau=r.tau - share * compute_gravity_torque(robot.model, r.q, down)) for r in logs
    ]


def test_torque_without_weight_is_suspected_beside_a_balanced_arm():
    robot, logs = clean_logs("irb140")
    (fault,) = check_logs(robot, without_weight(robot, logs, 0.9)).faults
    assert (fault.kind, fault.joints, fault.certain) == ("gravity_removed", (), False)
    assert "gravity = [0, 0, 0]" in fault.evidence
    assert any("balanced" in rival for rival in fault.rivals)
    assert fault.settle


@pytest.mark.long
def test_torque_without_weight_is_no_other_clock():
    arm_of_seven = host(SEVEN, 1)
    robot, logs = arm_of_seven.robot, arm_of_seven.logs[:2]
    (fault,) = check_logs(robot, without_weight(robot, logs)).faults
    assert (fault.kind, fault.certain) == ("gravity_removed", False)


def test_an_arm_that_lacks_the_weight_of_one_joint_has_a_clean_log():
    robot, logs = clean_logs("irb140")
    down, only = robot.model.gravity.linear, np.array([0, 1, 0, 0, 0, 0])
    balanced = [
        replace(r, tau=r.tau - only * compute_gravity_torque(robot.model, r.q, down)) for r in logs
    ]
    assert "gravity_removed" not in [kind for kind, *_ in kinds(robot, balanced)]


def referred(robot, logs, measured):
    """Logs with a reference, 10 ms ahead, and its torque where none is measured."""
    out = []
    for log in logs:
        rate = 1 / float(np.median(np.diff(log.t)))
        q = filter_low_pass(log.q, 5.0, rate)
        q = np.column_stack([np.interp(log.t + 0.01, log.t, x) for x in q.T])
        qd, qdd = (filter_low_pass(q, 25.0, rate, order=k) for k in (1, 2))
        tau = compute_inverse_dynamics(robot.model, q, qd, qdd) + 2.0 * np.tanh(qd / 0.01)
        out.append(replace(log, q_ref=q, tau=log.tau if measured else tau))
    return out


def test_a_torque_that_follows_from_the_reference_alone_is_a_command():
    robot, logs = clean_logs("irb140")
    logs = logs[:2]
    assert kinds(robot, referred(robot, logs, measured=True)) == []
    faults = check_logs(robot, referred(robot, logs, measured=False)).faults
    assert [(f.kind, f.joints) for f in faults] == [("commanded", ())]
    assert "columns of tau in --map" in faults[0].evidence


def test_a_torque_that_is_the_same_in_a_repeat_to_the_last_bit_is_a_command():
    robot, (log, *_) = clean_logs("small")
    noise = 5e-5 * np.random.default_rng(1).normal(size=log.q.shape)
    later = log.t + 60.0
    again = replace(log, id="again", t=later, q=log.q + noise)
    assert ("commanded", (), True) in kinds(robot, [log, again])
    shaken = 0.1 * np.random.default_rng(2).normal(size=log.q.shape)
    assert kinds(robot, [log, replace(again, tau=log.tau + shaken)]) == []
    # The same log twice is no command.
    assert kinds(robot, [log, replace(log, id="copy", t=later)]) == []


def grams(model):
    for body in model.inertias:
        body.mass *= 1000
        body.inertia = 1000 * body.inertia


def millimetres(model):
    for placement in model.jointPlacements:
        placement.translation = 1000 * placement.translation


def in_mm_per_s2(model):
    model.gravity.linear = np.array([0, 0, -9810.0])


@pytest.mark.parametrize("change", [grams, millimetres, in_mm_per_s2])
def test_a_robot_that_cannot_be_is_certain_and_reported_alone(change):
    robot, logs = clean_logs("irb140")
    model = pin.Model(robot.model)
    change(model)
    (fault,) = check_logs(replace(robot, model=model), logs).faults
    assert (fault.kind, fault.certain) == ("robot_file", True)


@pytest.mark.parametrize(("name", "sure"), [("small", False), ("irb140", True)])
def test_a_weight_that_the_file_says_is_held_and_the_torque_has_is_told(name, sure):
    robot, (log, *_) = clean_logs(name)
    every = np.tile(np.eye(4), (robot.dof, 1, 1))
    carried = CarriedWeight(every, np.ones(robot.dof, dtype=bool), ("link2",))
    arm_held = replace(robot, carried=carried)
    free, (fault,) = find_weight_in_torque(arm_held, filter_check_motion([log]))
    assert free.carried is None
    assert (fault.kind, fault.certain) == ("robot_file", sure)
    line = format_repair_lines(fault.repairs, robot, ColumnMap())
    assert line == "gravcomp = false"
    weight = compute_gravity_torque(robot.model, log.q, DOWN)
    motion = filter_check_motion([replace(log, tau=log.tau - weight)])
    assert find_weight_in_torque(arm_held, motion) == (arm_held, [])


def test_a_short_log_a_one_way_joint_and_joints_in_step_are_said():
    robot = arm()
    (log,) = plain_logs(robot, [0, 1], 0.0, count=1)
    rows = slice(0, 500)
    short = replace(log, t=log.t[rows], q=log.q[rows], tau=log.tau[rows])
    assert find_insufficient_motion([short], None)[0].kind == "too_short"
    one_way = np.column_stack([np.linspace(0, 1, len(log.t)), log.q[:, 1]])
    (fault,) = find_insufficient_motion([replace(log, q=one_way)], None)
    assert (fault.kind, fault.joints) == ("no_reversal", (1,))
    in_step = replace(log, q=np.column_stack([log.q[:, 0], -0.5 * log.q[:, 0]]))
    faults = check_logs(robot, [in_step]).faults
    assert ("lockstep", (1, 2)) in [(f.kind, f.joints) for f in faults]


def test_angles_beyond_their_range_or_in_degrees_are_said_with_their_joint():
    robot, logs = clean_logs("irb140")
    assert find_limit_violations(robot, logs) == []
    (fault,) = find_limit_violations(
        robot, edited(logs, q=lambda q: q + np.array([0, 4, 0, 0, 0, 0]))
    )
    assert (fault.kind, fault.joints, fault.certain) == ("out_of_range", (2,), False)
    robot, logs = clean_logs("small")
    factor = np.array([1.0, 180 / np.pi, 1.0])
    (fault,) = check_logs(robot, edited(logs, q=lambda q: q * factor)).faults
    assert (fault.kind, fault.joints, fault.certain) == ("angle_unit", (2,), True)
    assert fault.repairs == (Repair("q", (2,), scale=(np.pi / 180,)),)


@pytest.mark.parametrize("off", [0.6, 2.0])
def test_a_zero_that_is_far_off_is_no_exchange_of_joints(off):
    robot, logs = clean_logs("small")
    joint = 1
    high = max(log.q[:, joint].max() for log in logs)
    shift = np.zeros(3)
    shift[joint] = robot.upper[joint] + off - high
    (fault,) = check_logs(robot, edited(logs, q=lambda q: q + shift)).faults
    assert (fault.kind, fault.joints) == ("out_of_range", (2,))
