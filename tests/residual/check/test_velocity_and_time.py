"""Velocity is the derivative of the angle, in seconds; time runs evenly."""

from dataclasses import replace

import numpy as np
import pytest

from residual.check.check import check_logs
from residual.check.kinematics import time_unit, uneven, velocity_faults
from residual.check.result import Repair
from tests.residual.check.damaged import clean_logs, edited, swapped, times, turned


def with_velocity(logs):
    return [replace(r, qd=np.gradient(r.q, r.t, axis=0)) for r in logs]


def test_a_derivative_is_no_fault():
    _, logs = clean_logs("small")
    assert velocity_faults(with_velocity(logs)) == []
    assert velocity_faults(logs) == []


@pytest.mark.parametrize(
    ("changes", "kind", "joints", "repair"),
    [
        (
            {"qd": turned(2)},
            "velocity_mismatch",
            (2,),
            Repair("qd", (2,), sign=(-1,)),
        ),
        (
            {"qd": swapped(1, 3)},
            "velocity_mismatch",
            (1, 3),
            Repair("qd", order=(3, 2, 1)),
        ),
        (
            {"qd": times(180 / np.pi)},
            "angle_unit",
            (),
            Repair("qd", scale=np.pi / 180),
        ),
        ({"t": times(2)}, "time_unit", (), Repair("t", scale=0.5)),
    ],
)
def test_another_velocity_is_certain_and_comes_with_its_repair(
    changes, kind, joints, repair
):
    _, logs = clean_logs("small")
    (fault,) = velocity_faults(edited(with_velocity(logs), **changes))
    assert (fault.kind, fault.joints, fault.certain) == (kind, joints, True)
    assert fault.repairs == (repair,)


def test_a_velocity_of_something_else_is_doubtful():
    _, logs = clean_logs("small")
    noise = np.random.default_rng(1).normal(size=logs[0].q.shape)
    (fault,) = velocity_faults([replace(logs[0], qd=noise)])
    assert (fault.kind, fault.certain) == ("velocity_mismatch", False)


@pytest.mark.parametrize("unit", [1e3, 1e6, 1e-3])
def test_a_unit_of_time_that_no_logger_keeps_is_found_alone(unit):
    robot, logs = clean_logs("small")
    (fault,) = check_logs(robot, edited(logs, t=times(unit))).faults
    assert (fault.kind, fault.certain) == ("time_unit", True)
    assert fault.repairs[0].scale == pytest.approx(1 / unit)
    assert time_unit(robot, logs) is None


def test_gaps_and_uneven_steps_are_said():
    _, (log, *_) = clean_logs("small")
    rng = np.random.default_rng(2)
    step = np.median(np.diff(log.t))
    late = log.t + np.where(np.arange(len(log.t)) > 700, 0.5, 0.0)
    uneven_steps = log.t + step * rng.uniform(0, 0.9, len(log.t))
    assert uneven(log) == []
    assert [f.kind for f in uneven(replace(log, t=late))] == ["clock"]
    assert [f.kind for f in uneven(replace(log, t=uneven_steps))] == ["clock"]
