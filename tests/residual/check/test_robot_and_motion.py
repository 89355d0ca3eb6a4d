"""Robot files that cannot be, motions that say too little, values out of range."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from residual.check.check import body_faults, check_logs, enough
from residual.check.kinematics import out_of_range
from residual.check.result import Repair
from residual.robot.robot import load_robot
from tests.residual.arms import SEVEN, arm, plain_logs
from tests.residual.check.damaged import clean_logs, edited


def changed(robot, change):
    model = pin.Model(robot.model)
    change(model)
    return replace(robot, model=model)


def grams(model):
    for body in model.inertias:
        body.mass *= 1000
        body.inertia = 1000 * body.inertia


def millimetres(model):
    for placement in model.jointPlacements:
        placement.translation = 1000 * placement.translation


def negative(model):
    parameters = model.inertias[2].toDynamicParameters()
    parameters[4] = -1.0
    model.inertias[2] = pin.Inertia.FromDynamicParameters(parameters)


def in_millimetres_per_second_squared(model):
    model.gravity.linear = np.array([0, 0, -9810.0])


@pytest.mark.parametrize(
    "change", [grams, millimetres, negative, in_millimetres_per_second_squared]
)
def test_a_robot_that_cannot_be_is_certain_and_reported_alone(change):
    robot, logs = clean_logs("irb140")
    (fault,) = check_logs(changed(robot, change), logs).faults
    assert (fault.kind, fault.certain) == ("robot_file", True)


@pytest.mark.parametrize("robot", [arm(), arm(SEVEN), load_robot("irb140")])
def test_a_plain_robot_file_is_none(robot):
    assert body_faults(robot) == []


def test_a_short_log_a_one_way_joint_and_joints_in_step_are_said():
    robot = arm()
    (log,) = plain_logs(robot, [0, 1], 0.0, count=1)
    rows = slice(0, 500)
    short = replace(log, t=log.t[rows], q=log.q[rows], tau=log.tau[rows])
    assert enough([short], None)[0].kind == "too_short"
    one_way = np.column_stack([np.linspace(0, 1, len(log.t)), log.q[:, 1]])
    (fault,) = enough([replace(log, q=one_way)], None)
    assert (fault.kind, fault.joints) == ("no_reversal", (1,))
    in_step = replace(log, q=np.column_stack([log.q[:, 0], -0.5 * log.q[:, 0]]))
    faults = check_logs(robot, [in_step]).faults
    assert ("lockstep", (1, 2)) in [(f.kind, f.joints) for f in faults]


def test_angles_beyond_the_range_of_a_joint_are_said():
    robot, logs = clean_logs("irb140")
    assert out_of_range(robot, logs) == []
    (fault,) = out_of_range(
        robot, edited(logs, q=lambda q: q + np.array([0, 4, 0, 0, 0, 0]))
    )
    assert (fault.kind, fault.joints, fault.certain) == ("out_of_range", (2,), False)


def test_single_joints_in_degrees_are_certain():
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
