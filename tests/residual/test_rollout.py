"""A model that goes by itself under the goal of a log."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from residual.drive import Drive, compute_drive_torque
from residual.effects import load_effects
from residual.model.dynamics import compute_position_errors, simulate_position
from residual.model.model import Model, Term
from residual.recording import Recording
from residual.robot.robot import build_robot, load_robot

PENDULUM = """<robot name="pendulum"><link name="base"/><link name="bob"><inertial>
<origin xyz="0 0 -0.15"/><mass value="0.8"/><inertia ixx="1e-3" iyy="1e-3" izz="1e-5"
ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="j" type="continuous">
<parent link="base"/><child link="bob"/><axis xyz="0 1 0"/>
<limit effort="20" velocity="20"/></joint></robot>"""
T = np.arange(0, 2, 0.01)


def place(name, *theta, joints=(0,), shape=()):
    return Term(load_effects()[name], joints, shape, np.array(theta))


def build_model(robot, *terms):
    bodies = list(robot.model.inertias)[1:]
    inertial = np.concatenate([body.toDynamicParameters() for body in bodies])
    return Model(robot, inertial, terms)


@pytest.fixture
def robot():
    return build_robot("pendulum", PENDULUM, "{}")


def record(q, goal, drive, **more):
    q, goal = np.broadcast_to(q, goal.shape), goal
    return Recording("log", "arm", T, q, 0 * q, q_ref=goal, drive=drive, **more)


def test_a_pendulum_goes_where_the_equation_of_motion_takes_it(robot):
    goal = np.where(T < 1.0, 0.5, -0.8)[:, None]
    log = record(0.2, goal, Drive(gain=(6.0,), limit=(2.0,), delay=(0.1,)))
    model = build_model(robot, place("viscous", 0.3), place("rotor_inertia", 0.02))

    def follow(t, x):
        to = np.interp(t - 0.1, T, goal[:, 0])
        tau = np.clip(6.0 * (to - x[0]), -2, 2) - 0.3 * x[1]
        inertia = 1e-3 + 0.8 * 0.15**2 + 0.02
        return x[1], (tau - 0.8 * 9.81 * 0.15 * np.sin(x[0])) / inertia

    exact = solve_ivp(follow, (0, T[-1]), (0.2, 0), t_eval=T, max_step=5e-3).y[0]
    rollout = simulate_position(model, log)
    assert rollout.diverged is None
    np.testing.assert_allclose(rollout.q[:, 0], exact, atol=0.006)  # one ms at 6 rad/s


def test_dry_friction_holds_a_joint_until_the_goal_is_far_enough(robot):
    goal = np.where(T < 1.0, 0.09, 0.5)[:, None]
    model = build_model(robot, place("coulomb", 0.6))
    q = simulate_position(model, record(0.0, goal, Drive(gain=(6.0,)))).q[:, 0]
    assert np.abs(q[T < 0.985]).max() < 1e-9
    assert 6.0 * (0.5 - q[-1]) - 0.8 * 9.81 * 0.15 * np.sin(q[-1]) <= 0.6
    assert q[-1] > 0.2
    assert np.ptp(q[T > 1.7]) < 1e-9


def test_a_drive_that_is_off_lets_the_arm_fall(robot):
    goal, off = np.full((len(T), 1), 1.0), (T < 0.5)[:, None]
    log = record(1.0, goal, Drive(gain=(60.0,)), enabled=off)
    q = simulate_position(build_model(robot, place("viscous", 0.2)), log).q[:, 0]
    assert np.abs(q[T < 0.5] - 1.0).max() < 0.05
    assert abs(q[-1]) < 0.1


def test_a_model_that_runs_away_is_said_to_diverge(robot):
    goal = np.zeros((len(T), 1))
    wrong = build_model(robot, place("rotor_inertia", -0.03))
    rollout = simulate_position(wrong, record(0.1, goal, Drive(gain=(6.0,))))
    assert 0 < rollout.diverged < 2
    assert np.isnan(rollout.q[-1]).all()


def test_every_effect_that_the_state_decides_acts_as_the_model_has_it():
    """The torque of the model on the motion that it made is that of the drives."""
    robot = load_robot("irb140")
    every = [(j,) for j in range(6)]
    terms = [place("viscous", 40.0, joints=j) for j in every]
    terms += [place("rotor_inertia", 2.0, joints=j) for j in every]
    terms += [
        place("payload", 3.0, 0.1, 0.0, 0.3, 0.05, 0, 0.05, 0, 0, 0.05, joints=(5,)),
        place("base_tilt", 0.5, -0.3, joints=()),
        place("tool_force", 5.0, 9.0, -7.0, joints=()),
        place("spring", 8.0, 3.0, joints=(1,)),
        place("power_viscous", 5.0, joints=(2,), shape=(0.5,)),
        place("coupled_friction", 3.0, 4.0, 0.0, joints=(4, 5), shape=(1.0, 0.1)),
        place("load_friction", 0.1, joints=(1,)),
        place("coulomb_asymmetry", 6.0, joints=(0,)),
        place("torque_gain", 0.2, joints=(3,)),
    ]
    model = build_model(robot, *terms, place("elasticity", 1e-5, joints=(1,)))
    waves = 0.4 * np.sin(T[:, None] * (1.0 + 0.3 * np.arange(6)) + np.arange(6))
    gain = (4000.0, 4000.0, 3000.0, 900.0, 900.0, 900.0)
    log = record(waves[0], waves, Drive(gain=gain))
    rollout = simulate_position(model, log)
    assert rollout.left_out == ("elasticity",)
    qd = np.gradient(rollout.q, T, axis=0)
    motion = rollout.q, qd, np.gradient(qd, T, axis=0)
    expected = replace(model, terms=tuple(terms)).along(T, motion)
    tau, _ = compute_drive_torque(log.drive, waves, rollout.q, T)
    moving = (T > 0.5) & (np.abs(qd).min(axis=1) > 0.03)
    size = np.sqrt(np.mean(tau[moving] ** 2, axis=0))
    missed = np.sqrt(np.mean((tau - expected)[moving] ** 2, axis=0))
    assert moving.sum() > 50
    assert (missed < 0.05 * size).all(), missed / size


def test_position_errors_are_of_each_model_and_of_logs_with_drives_alone(robot):
    goal = np.where(T < 1.0, 0.5, -0.8)[:, None]
    model = build_model(robot, place("viscous", 0.5))
    log = record(0.2, goal, Drive(gain=(6.0,)))
    log = replace(log, q=simulate_position(model, log).q)
    models = {
        "nominal": build_model(robot, place("viscous", 2.0)),
        "augmented": model,
        "wrong": build_model(robot, place("rotor_inertia", -0.03)),
    }
    errors = compute_position_errors(models, [log, replace(log, drive=None)])
    assert errors.overall["augmented"] < 4e-3 < 0.05 < errors.rms["nominal"][0]
    assert errors.rms["wrong"] is errors.overall["wrong"] is None
    (where,) = errors.diverged["wrong"]
    assert where.startswith("log at ")
    assert compute_position_errors(models, [replace(log, drive=None)]) is None


def test_damping_by_a_drive_goes_when_the_drive_is_off(robot):
    log = record(1.0, np.zeros((len(T), 1)), Drive(), enabled=np.zeros((len(T), 1)))
    free, damped = (
        simulate_position(build_model(robot, *terms), log).q
        for terms in ((), (place("drive_damping", 5.0),))
    )
    np.testing.assert_array_equal(free, damped)
    assert np.ptp(free) > 1.5
