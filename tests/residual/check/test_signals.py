"""Bad samples, velocities, clocks and still angles are named with their joint."""

from dataclasses import replace

import numpy as np
import pytest

from residual.check.check import check_logs
from residual.check.kinematics import find_time_unit, find_velocity_faults
from residual.check.kinematics import find_uneven_time_steps as uneven_time_steps
from residual.check.result import Repair
from residual.check.sample_faults import find_constant_angles, find_frozen_signals, find_spikes
from residual.errors import InputError
from residual.recording import Recording
from residual.robot.dynamics import compute_inverse_dynamics
from sim.engine.plant_records import create_random_stream
from sim.plant.sensors import draw_torque_noise
from sim.plant.typical_sizes import estimate_typical_sizes
from tests.residual.arms import arm, bare_irb140, plain_logs
from tests.residual.check.damaged import AXES, clean_logs, edited, kinds, swapped, times, turned
from tests.synthetic.motions import make_motion
from tests.synthetic.quasi_static import Plant, true_torque
from warehouse.logs.column_map import build_default_signal, convert_to_link_side


@pytest.mark.parametrize("size", [300.0, 1e30, 1e308])
def test_a_spike_of_any_size_is_found_with_its_joint_and_log(size):
    logs = plain_logs(arm(), [0, 1], 0.0, count=2)
    tau = np.array(logs[1].tau)
    tau[400, 1] = size
    page = check_logs(arm(), [logs[0], replace(logs[1], tau=tau)])
    assert [(f.kind, f.joints, f.log) for f in page.faults] == [("spike", (2,), "log1")]


def test_noise_and_friction_are_no_fault_and_no_log_is_an_error():
    with pytest.raises(InputError, match="at least one recording"):
        check_logs(arm(), [])
    assert check_logs(arm(), plain_logs(arm(), [0, 1], 0.0)).faults == ()
    _, logs = clean_logs("small")
    assert find_velocity_faults(with_velocity(logs)) == []
    assert find_velocity_faults(logs) == []


def frozen(joint):
    def change(x):
        x[300:450, joint - 1] = x[300, joint - 1]

    return change


def cut(tau):
    limit = np.quantile(np.abs(tau[:, 1]), 0.8)
    tau[:, 1] = np.clip(tau[:, 1], -limit, limit)


def coarse(share):
    def change(tau):
        step = share * tau[:, 0].std()
        tau[:, 0] = np.round(tau[:, 0] / step) * step

    return change


@pytest.mark.parametrize(
    ("signal", "change", "said"),
    [
        ("tau", frozen(1), [("frozen", (1,), False)]),
        ("q", frozen(2), [("frozen", (2,), False)]),
        ("tau", cut, [("saturated", (2,), False)]),
        ("tau", coarse(0.3), [("quantised", (1,), False)]),
        ("tau", coarse(0.01), []),
    ],
)
def test_what_stands_is_said_with_its_joint(signal, change, said):
    (log,) = plain_logs(arm(), [0, 1], 0.0, count=1)
    values = np.array(getattr(log, signal))
    change(values)
    faults = find_frozen_signals(replace(log, **{signal: values}))
    assert [(f.kind, f.joints, f.certain) for f in faults] == said


def test_an_encoder_that_wraps_is_not_taken_for_degrees():
    robot, logs = clean_logs("small")
    bad = edited(logs, q=lambda q: np.column_stack([q[:, 0], q[:, 1:] % (2 * np.pi)]))
    faults = check_logs(robot, bad).faults
    assert {(f.kind, f.certain) for f in faults} == {("out_of_range", True)}
    assert set(faults[0].joints) <= {2, 3}
    (repair,) = faults[0].repairs
    assert (repair.signal, repair.unwrap) == ("q", True)
    signal = replace(build_default_signal("q", 3), unwrap=True)
    for own, log in zip(logs, bad, strict=True):
        mended = convert_to_link_side("q", log.q, signal, robot)
        turns = (mended - own.q) / (2 * np.pi)  # the first sample may be a turn off
        assert np.ptp(turns, axis=0).max() < 1e-9
    degrees = edited(logs, q=np.rad2deg)
    assert "out_of_range" not in [f.kind for f in check_logs(robot, degrees).faults]


def test_a_unit_of_two_torques_is_not_said_of_all():
    robot, logs = clean_logs("irb140")
    damaged = edited(logs[:1], tau=lambda tau: tau * [1, 1e3, 1, 1e3, 1, 1])
    assert not [f for f in check_logs(robot, damaged).faults if f.certain]


def with_velocity(logs):
    return [replace(r, qd=np.gradient(r.q, r.t, axis=0)) for r in logs]


@pytest.mark.parametrize(
    ("changes", "kind", "joints", "repair"),
    [
        ({"qd": turned(2)}, "velocity_mismatch", (2,), Repair("qd", (2,), sign=(-1,))),
        ({"qd": swapped(1, 3)}, "velocity_mismatch", (1, 3), Repair("qd", order=(3, 2, 1))),
        ({"qd": times(180 / np.pi)}, "angle_unit", (), Repair("qd", scale=np.pi / 180)),
        ({"t": times(2)}, "time_unit", (), Repair("t", scale=0.5)),
    ],
)
def test_another_velocity_is_certain_and_has_its_repair(changes, kind, joints, repair):
    _, logs = clean_logs("small")
    (fault,) = find_velocity_faults(edited(with_velocity(logs), **changes))
    assert (fault.kind, fault.joints, fault.certain) == (kind, joints, True)
    assert fault.repairs == (repair,)


def test_a_velocity_of_another_size_is_mended_by_its_factor():
    _, logs = clean_logs("small")
    (fault,) = find_velocity_faults(edited(with_velocity(logs), qd=lambda qd: qd * [1, 3, 1]))
    assert (fault.kind, fault.joints) == ("velocity_mismatch", (2,))
    assert fault.repairs[0].scale == pytest.approx((1 / 3,), rel=0.02)


@pytest.mark.parametrize("unit", [1e3, 1e6, 1e-3])
def test_a_unit_of_time_that_no_logger_keeps_is_found_alone(unit):
    robot, logs = clean_logs("small")
    (fault,) = check_logs(robot, edited(logs, t=times(unit))).faults
    assert (fault.kind, fault.certain) == ("time_unit", True)
    assert fault.repairs[0].scale == pytest.approx(1 / unit)
    assert find_time_unit(robot, logs) is None


def test_gaps_and_uneven_steps_are_said():
    _, (log, *_) = clean_logs("small")
    rng = np.random.default_rng(2)
    step = np.median(np.diff(log.t))
    late = log.t + np.where(np.arange(len(log.t)) > 700, 0.5, 0.0)
    steps = log.t + step * rng.uniform(0, 0.9, len(log.t))
    assert uneven_time_steps(log) == []
    assert [f.kind for f in uneven_time_steps(replace(log, t=late))] == ["clock"]
    assert [f.kind for f in uneven_time_steps(replace(log, t=steps))] == ["clock"]


def dead(log, joint):
    q = np.array(log.q)
    q[:, joint - 1] = q[0, joint - 1]
    return replace(log, q=q)


@pytest.mark.parametrize("joint", [2, 5])
def test_an_angle_that_never_changes_while_its_torque_moves_is_told(joint):
    robot, logs = clean_logs("irb140")
    faults = check_logs(robot, [dead(logs[0], joint), *logs[1:]]).faults
    (fault,) = faults
    assert (fault.kind, fault.joints, fault.log) == ("constant", (joint,), logs[0].id)
    assert "columns of q in --map" in faults[0].evidence


def test_it_is_certain_where_torque_speed_or_reference_are_those_of_a_moving_joint():
    robot, (log, *_) = clean_logs("irb140")
    assert kinds(robot, [dead(log, 2)]) == [("constant", (2,), True)]
    qd = np.gradient(log.q, log.t, axis=0)
    for also in ({"qd": qd}, {"q_ref": log.q}):
        faults = kinds(robot, [replace(dead(log, 6), **also)])
        assert ("constant", (6,), True) in faults


@pytest.mark.parametrize("joint", [1, 3])
def test_a_joint_that_is_held_has_a_clean_log(joint):
    robot = bare_irb140()
    plant, j = Plant(robot, (), 5), joint - 1
    logs = []
    for i, family in enumerate(("fourier", "cyclic")):
        motion = make_motion(family, robot, 12.0, 125.0, create_random_stream(5, family))
        q, qd, qdd = (np.array(x) for x in (motion.q, motion.qd, motion.qdd))
        q[:, j], qd[:, j], qdd[:, j] = q[0, j], 0.0, 0.0
        tau = true_torque(plant, replace(motion, q=q, qd=qd, qdd=qdd), family).tau
        noise = draw_torque_noise(
            len(tau), estimate_typical_sizes(robot).torque, 125.0, create_random_stream(5, str(i))
        )
        rough = q + 5e-5 * create_random_stream(6, family).normal(size=q.shape)
        rough[:, j] = q[:, j]
        log = Recording(family, robot.name, 30.0 * i + motion.t, rough, tau + noise)
        logs.append(log)
    assert kinds(robot, logs) == []
    if joint == 3:
        (fault,) = kinds(robot, [replace(log, tau=1e3 * log.tau) for log in logs])
        assert fault == ("torque_unit", (), True)


def jointwise(robot, bit=3.8e-4):
    """A log in which joint 1 moves; the bits of the others' sensors toggle."""
    t = np.arange(0, 16, 0.02)
    q, qd, qdd = np.zeros((3, len(t), robot.dof))
    q += np.linspace(0.4, -0.3, robot.dof)
    for size, w in ((0.5, 1.9), (0.2, 4.1)):
        q[:, 0] += size * np.sin(w * t)
        qd[:, 0] += size * w * np.cos(w * t)
        qdd[:, 0] -= size * w**2 * np.sin(w * t)
    tau = compute_inverse_dynamics(robot.model, q, qd, qdd)
    tau[:, 0] += 2 * np.tanh(qd[:, 0] / 0.05) + qd[:, 0]
    tau[:, 1:] = tau[0, 1:]  # their gears hold them
    tau += 0.02 * (np.random.default_rng(1).random(tau.shape) < 0.1)
    q = bit * np.round(q / bit)
    q[[100, 420], -1] += bit
    return Recording("jointwise", robot.name, t, q, tau)


@pytest.mark.parametrize("axes", [AXES[1:], AXES])
def test_joints_that_are_held_while_one_moves_raise_no_alarm(axes):
    robot = arm(axes)
    log = jointwise(robot)
    assert check_logs(robot, [log]).faults == ()
    held = replace(log, q=np.where(np.arange(robot.dof) > 0, log.q[0], log.q))
    assert find_constant_angles(robot, held) == []
    q, tau = np.array(log.q), np.array(log.tau)
    q[300, -1] += 0.05
    tau[300, -1] += 2.0
    faults = find_spikes(replace(log, q=q, tau=tau))
    assert [f.joints for f in faults] == 2 * [(robot.dof,)]
