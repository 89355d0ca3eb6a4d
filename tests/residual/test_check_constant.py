"""An angle of one value is a fault where its joint moves, none where it is held."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.synthetic.motions import make_motion
from residual.check.check import check_logs
from residual.recording import Recording
from sim.plant.sensors import torque_noise
from sim.quasi_static import Plant, true_torque
from sim.records import stream
from sim.sizes import sizes, usual_limits
from tests.residual.arms import bare_irb140
from tests.residual.check.damaged import clean_logs


def kinds(robot, logs):
    return [(f.kind, f.joints, f.certain) for f in check_logs(robot, logs).faults]


def dead(log, joint):
    q = np.array(log.q)
    q[:, joint - 1] = q[0, joint - 1]
    return replace(log, q=q)


@pytest.mark.parametrize("joint", [1, 2, 3, 5])
def test_an_angle_that_never_changes_while_its_torque_moves_is_told(joint):
    robot, logs = clean_logs("irb140")
    found = check_logs(robot, [dead(logs[0], joint), *logs[1:]]).faults
    assert [(f.kind, f.joints, f.log) for f in found] == [
        ("constant", (joint,), logs[0].id)
    ]
    assert "columns of q in --map" in found[0].evidence


def test_it_is_certain_where_torque_speed_or_reference_are_those_of_a_moving_joint():
    robot, (log, *_) = clean_logs("irb140")
    assert kinds(robot, [dead(log, 2)]) == [("constant", (2,), True)]
    qd = np.gradient(log.q, log.t, axis=0)
    for also in ({"qd": qd}, {"q_ref": log.q}):
        said = kinds(robot, [replace(dead(log, 6), **also)])
        assert ("constant", (6,), True) in said


@pytest.mark.parametrize("joint", [1, 2, 3, 6])
def test_a_joint_that_is_held_has_a_clean_log(joint):
    robot = bare_irb140()
    plant, j = Plant(robot, (), 5), joint - 1
    logs = []
    for i, family in enumerate(("fourier", "cyclic")):
        motion = make_motion(
            family, usual_limits(robot), 12.0, 125.0, stream(5, family)
        )
        q, qd, qdd = (np.array(x) for x in (motion.q, motion.qd, motion.qdd))
        q[:, j], qd[:, j], qdd[:, j] = q[0, j], 0.0, 0.0
        still = replace(motion, q=q, qd=qd, qdd=qdd)
        tau = true_torque(plant, still, family).tau
        noise = torque_noise(len(tau), sizes(robot).torque, 125.0, stream(5, str(i)))
        rough = q + 5e-5 * stream(6, family).normal(size=q.shape)
        rough[:, j] = q[:, j]
        log = Recording(family, robot.name, 30.0 * i + motion.t, rough, tau + noise)
        logs.append(log)
    assert kinds(robot, logs) == []
    if joint == 3:
        (found,) = kinds(robot, [replace(log, tau=1e3 * log.tau) for log in logs])
        assert found == ("torque_unit", (), True)
