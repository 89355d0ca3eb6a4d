"""Torque that lost its step with the angles is no other arm: never a certain fault."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from residual.check.check import check_logs
from residual.check.late import long_late
from residual.check.motion import thin_rows
from residual.robot.robot import load_robot
from tests.residual.arms import bare_irb140
from warehouse.logs import read_log

EXAMPLE = Path(__file__).parents[3] / "examples" / "hidden"
UR10 = Path(__file__).parents[4] / "shared" / "data" / "ur10" / "ur10.urdf"


def logs():
    robot = bare_irb140()
    return robot, [read_log(str(EXAMPLE / f"fit_{k}.csv"), robot)[0] for k in (1, 2)]


def moved(log, seconds):
    """The same with its torque so much later."""
    tau = [np.interp(log.t - seconds, log.t, column) for column in log.tau.T]
    return replace(log, tau=np.column_stack(tau))


def without(log, at, rows=25):
    """The same with a block of its torque dropped: the rest moves up."""
    k = int(at * len(log.t))
    last = np.repeat(log.tau[-1:], rows, axis=0)
    tau = np.concatenate([log.tau[:k], log.tau[k + rows :], last])
    return replace(log, tau=tau)


@pytest.mark.parametrize("seconds", [0.12, 0.2, -0.2])
def test_a_long_delay_is_a_delay(seconds):
    robot, clean = logs()
    (fault,) = check_logs(robot, [moved(log, seconds) for log in clean]).faults
    assert (fault.kind, fault.certain) == ("delay", False)
    assert f"{abs(seconds):.2g} s" in fault.evidence
    assert ("later" if seconds > 0 else "earlier") in fault.evidence


@pytest.mark.parametrize("at", [0.3, 0.6])
def test_a_block_that_was_dropped_on_the_way_is_doubted_and_not_certain(at):
    robot, clean = logs()
    (fault,) = check_logs(robot, [without(log, at) for log in clean]).faults
    assert (fault.kind, fault.certain) == ("wrong_robot", False)
    assert "parts of the logs fit" in fault.evidence


def test_logs_in_step_are_not_moved():
    robot, clean = logs()
    assert long_late(robot, thin_rows(clean), clean) == []


@pytest.mark.skipif(not UR10.exists(), reason="measured robots are not beside it")
def test_another_arm_is_one_in_every_part():
    _, clean = logs()
    (fault,) = check_logs(load_robot(UR10), clean).faults
    assert (fault.kind, fault.certain) == ("wrong_robot", True)
