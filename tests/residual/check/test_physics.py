"""Signs, orders and units that cannot be are found by the physics of the motion."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.check_parts.arms import SIX, host, other_arms
from residual.check.check import check_logs, list_odd_logs
from residual.check.result import Repair
from residual.robot.robot import replace_gravity
from sim.engine.plant_records import create_random_stream
from sim.plant.typical_sizes import draw_effect
from tests.residual.check.damaged import clean_logs, edited, kinds, swapped, times, turned

DAMAGES = {
    "torque of one joint": ({"tau": turned(2)}, "torque_sign", (2,)),
    "all torques": ({"tau": times(-1)}, "torque_sign", (1, 2, 3)),
    "angle": ({"q": turned(2)}, "angle_sign", (2,)),
    "two joints": ({"q": swapped(2, 3), "tau": swapped(2, 3)}, "joint_order", (2, 3)),
    "two torques": ({"tau": swapped(1, 2)}, "joint_order", (1, 2)),
    "two angles": ({"q": swapped(2, 3)}, "joint_order", (2, 3)),
    "N mm": ({"tau": times(1e3)}, "torque_unit", ()),
    "kN m": ({"tau": times(1e-3)}, "torque_unit", ()),
    "all angles": ({"q": times(-1)}, "angle_sign", (1, 2, 3)),
    "degrees": ({"q": times(57.29578)}, "angle_unit", ()),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_wrong_column_map_is_certain_and_has_its_name_and_joints(damage):
    changes, kind, joints = DAMAGES[damage]
    robot, logs = clean_logs("small")
    assert kinds(robot, edited(logs, **changes)) == [(kind, joints, True)]


def test_joints_in_a_circle_are_put_back_in_order():
    robot, logs = clean_logs("small")

    def cycled(x):
        return x[:, [1, 2, 0]]

    (fault,) = check_logs(robot, edited(logs, q=cycled, tau=cycled)).faults
    order = (3, 1, 2)
    assert fault.repairs == (Repair("q", order=order), Repair("tau", order=order))


@pytest.mark.parametrize("effect", ["payload", pytest.param("base_tilt", marks=pytest.mark.long)])
def test_an_arm_that_hides_something_has_a_clean_log(effect):
    robot, _ = clean_logs("irb140")
    hidden = (draw_effect(robot, effect, create_random_stream(1, effect)),)
    robot, logs = clean_logs("irb140", 4, hidden)
    assert check_logs(robot, logs).faults == ()


@pytest.mark.parametrize(("seed", "build"), [(3, 1), pytest.param(6, 0, marks=pytest.mark.long)])
def test_an_arm_is_the_wrong_one_where_its_torque_is_not_in_the_logs(seed, build):
    # No joint but one or two would be far from a rough file.
    logs = host(SIX, seed).logs[:2]
    faults = check_logs(other_arms(6)[build], logs).faults
    (fault,) = faults
    assert (fault.kind, fault.joints, fault.certain) == ("wrong_robot", (), False)
    assert fault.repairs == ()


def test_a_reading_that_leaves_nothing_of_the_file_in_the_torque_is_not_certain():
    # Angles so small that a constant is all that the file has left.
    log = host(SIX, 5).logs[0]
    report = check_logs(other_arms(6)[2], [log])
    assert report.faults
    assert not report.certain


def test_a_time_twice_as_long_is_found_by_weight_against_inertia():
    robot, logs = clean_logs("small")
    (fault,) = check_logs(robot, edited(logs, t=times(2))).faults
    # The inertia of a file may be a placeholder: it is no clock.
    assert (fault.kind, fault.joints, fault.certain) == ("time_unit", (), False)
    assert fault.repairs == (Repair("t", scale=0.5),)
    assert fault.settle


def test_torques_of_the_motors_are_found_and_mended_where_the_gears_are_known():
    robot, logs = clean_logs("small")
    gears = np.array([120.0, 100.0, 80.0])
    damaged = edited(logs, tau=lambda tau: tau / gears)
    (fault,) = check_logs(robot, damaged).faults
    assert (fault.kind, fault.certain) == ("gear_ratio", True)
    assert "about 120 (joint 1), 99 (joint 2), 79 (joint 3)" in fault.evidence
    assert not fault.repairs
    (fault,) = check_logs(replace(robot, gear_ratio=gears), damaged).faults
    assert fault.repairs == (Repair("tau", (1, 2, 3), scale=(120.0, 100.0, 80.0)),)


def test_angles_of_the_motors_are_mended_by_known_gears():
    robot, logs = clean_logs("small")
    gears = np.array([120.0, 100.0, 80.0])
    geared = replace(robot, gear_ratio=gears)
    assert kinds(geared, logs) == []
    (fault,) = check_logs(geared, edited(logs, q=lambda q: q * gears)).faults
    assert (fault.kind, fault.certain) == ("gear_ratio", True)
    (repair,) = fault.repairs
    assert repair.signal == "q"
    assert repair.scale == pytest.approx(tuple(1 / gears))
    both = edited(logs, q=lambda q: q * gears, tau=lambda tau: tau / gears)
    (fault,) = check_logs(geared, both).faults
    assert {repair.signal for repair in fault.repairs} == {"tau", "q"}


def test_velocity_and_reference_are_mended_with_their_angle():
    robot, logs = clean_logs("small")
    both = [replace(r, qd=np.gradient(r.q, r.t, axis=0), q_ref=r.q) for r in logs]
    (fault,) = check_logs(robot, edited(both, q=turned(2))).faults
    assert fault.repairs == (Repair("q", (2,), sign=(-1,)),)
    every = {"q": turned(2), "qd": turned(2), "q_ref": turned(2)}
    (fault,) = check_logs(robot, edited(both, **every)).faults
    assert {r.signal for r in fault.repairs} == {"q", "qd", "q_ref"}
    (fault,) = check_logs(robot, edited(both, q=times(180 / np.pi))).faults
    assert fault.repairs == (Repair("q", scale=np.pi / 180),)
    shown = {"q": times(180 / np.pi), "q_ref": times(180 / np.pi)}
    (fault,) = check_logs(robot, edited(both, **shown)).faults
    assert {r.signal for r in fault.repairs} == {"q", "q_ref"}


@pytest.mark.parametrize("degrees", [15, pytest.param(180, marks=pytest.mark.long)])
def test_another_mounting_is_certain_and_its_line_is_the_direction(degrees):
    robot, logs = clean_logs("irb140")
    angle = np.deg2rad(degrees)
    wrong = 9.81 * np.array([np.sin(angle), 0.0, -np.cos(angle)])
    (fault,) = check_logs(replace_gravity(robot, wrong), logs).faults
    assert (fault.kind, fault.joints, fault.certain) == ("mounting", (), True)
    direction = np.array(fault.repairs[0].gravity) / 9.81
    assert np.degrees(np.arccos(min(1.0, -direction[2]))) < 3.0  # masses are off by 2 %


@pytest.fixture
def amperes():
    _, logs = clean_logs("irb140")
    return edited(logs, tau=times(1 / np.array([8.0, 15, 10, 12, 9, 14])))


def test_currents_beside_another_order_are_two_faults(amperes):
    robot, _ = clean_logs("irb140")
    both = edited(amperes, q=swapped(1, 3), tau=swapped(1, 3))
    order, unit, *_ = check_logs(robot, both).faults
    # An order beside factors without a name: a wrong robot may look like that.
    assert (order.kind, order.joints, order.certain) == ("joint_order", (1, 3), False)
    assert order.repairs[0].order == (3, 2, 1, 4, 5, 6)
    assert (unit.kind, unit.certain) == ("torque_unit", False)


@pytest.mark.long
def test_currents_beside_another_mounting_are_two_faults(amperes):
    wall = replace_gravity(clean_logs("irb140")[0], [9.81, 0.0, 0.0])
    mounted, unit = check_logs(wall, amperes).faults
    assert (mounted.kind, unit.kind) == ("mounting", "torque_unit")
    assert mounted.repairs[0].gravity == pytest.approx((0, 0, -9.81))


# A log is checked alone only where it misses more of the common arm.


def test_no_log_of_one_arm_is_odd_and_one_of_other_columns_is(recwarn):
    robot, logs = clean_logs("irb140")
    assert list_odd_logs(robot, logs) == []
    bad = edited(logs[:1], q=swapped(2, 3), tau=swapped(2, 3))
    assert bad[0] in list_odd_logs(robot, [*bad, *logs[1:]])
    held = edited(logs, q=lambda q: np.column_stack([q[:, :5], 0 * q[:, 5]]))
    list_odd_logs(robot, held)
    assert not recwarn.list
