"""What models predict: errors of torque, acceleration, and motion under a goal."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

from residual.drive import Drive, compute_drive_torque
from residual.effects import load_effects
from residual.model.compare import compute_model_errors as model_errors
from residual.model.compare import compute_moving_error, prepare_held_out
from residual.model.dynamics import (
    compute_acceleration,
    compute_model_mass_matrix,
    compute_position_errors,
    simulate_position,
)
from residual.model.model import Model, Term
from residual.recording import Recording
from residual.robot.dynamics import (
    compute_inverse_dynamics,
    find_flange_placement,
    read_inertial_parameters,
)
from residual.robot.robot import build_robot, load_robot
from residual.signals.splitting import find_session_start, split_off_last_quarter
from residual.signals.track import FilterSettings, StandstillFriction, build_tracks
from tests.residual.arms import arm, recording, smooth_motion

# The figures of the proof, by hand; what is held out, and the clock of a session.


def log(start, end, label="log", rate=100):
    t = start + np.arange(round((end - start) * rate) + 1) / rate
    q = 0.3 * np.sin(np.outer(t - start, (1.0, 1.3)))
    return recording(t, q, 0 * q, label)


@pytest.fixture
def proof():
    """Two logs whose measured torque is the model's, 10 % larger on joint 2."""
    robot = arm()
    model = Model(robot, read_inertial_parameters(robot.model), (), np.full(2, 0.01))
    logs = []
    for k in range(2):
        t = 50.0 * k + np.arange(1000) / 250
        q, qd, qdd = smooth_motion(robot, t)
        tau = compute_inverse_dynamics(robot.model, q, qd, qdd) * [1.0, 1.1]
        logs.append(recording(t, q, tau, f"log{k}"))
    return model, logs


def errors_of(model, logs):
    return model_errors({"it": model}, prepare_held_out(logs, model), FilterSettings())[0]["it"]


def test_a_scaled_torque_has_the_error_of_its_scale(proof):
    model, logs = proof
    for kind in ("raw", "filtered", "moving"):
        errors = errors_of(model, logs).per_joint(kind)
        assert_allclose(errors, [0, 100 * 0.1 / 1.1], atol=0.3)
    silent = replace(model, inertial=0 * model.inertial)
    assert_allclose(errors_of(silent, logs).per_joint("raw"), 100.0)


def test_noise_above_the_filter_counts_in_the_raw_error_only(proof):
    model, logs = proof
    hum = [replace(r, tau=r.tau + 8 * np.sin(377 * r.t)[:, None]) for r in logs]
    errors = errors_of(model, hum)
    assert errors.per_joint("raw")[0] > 10
    for kind in ("filtered", "moving"):
        assert_allclose(errors.per_joint(kind), [0, 100 * 0.1 / 1.1], atol=0.5)


def test_proof_curves_are_those_that_the_errors_are_taken_of(proof):
    model, logs = proof
    seen = prepare_held_out(logs, model)
    errors, curves = model_errors({"it": model}, seen, FilterSettings())
    miss = sum(((c.tau - c.tau_hat["it"]) ** 2).sum(axis=0) for c in curves)
    assert_allclose(miss, errors["it"].miss["filtered"])
    moving = sum((((c.tau - c.tau_hat["it"]) * c.moving) ** 2).sum(axis=0) for c in curves)
    assert_allclose(moving, errors["it"].miss["moving"])
    assert_allclose(compute_moving_error(model, seen).sum(axis=0), moving)


def test_the_last_quarter_of_the_longest_log_is_held_out():
    short, long = log(0, 6, "A"), log(10, 30, "B")
    fit, held_out = split_off_last_quarter([short, long])
    (tail,) = held_out
    assert fit[0] is short
    assert fit[1].id == "B"
    assert tail.id == "B (last quarter)"
    assert len(fit[1].t) + len(tail.t) == len(long.t)
    assert fit[1].t[-1] < tail.t[0] == pytest.approx(25.0)
    np.testing.assert_array_equal(np.concatenate([fit[1].q, tail.q]), long.q)


@pytest.mark.parametrize(
    ("spans", "clock"),
    [
        ([(0, 5)], 0.0),
        ([(100, 105), (110, 115)], 100.0),
        ([(110, 115), (100, 105)], 100.0),
        ([(0, 5), (0, 5)], None),
        ([(0, 5), (4, 9)], None),
        ([(3, 8), (0, 2), (2.5, 2.9)], 0.0),
    ],
)
def test_a_session_has_a_clock_where_the_times_show_the_order_of_its_logs(spans, clock):
    logs = [log(a, b, str(i)) for i, (a, b) in enumerate(spans)]
    assert find_session_start(logs) == clock


# Torque in, motion out, against Pinocchio's own algorithm and an integrator of SciPy.


ROBOT = load_robot("irb140")
MASS, LEVER = 2.0, np.array([0.05, 0.02, 0.08])  # of a load on the flange [kg, m]
OWN = np.diag([0.004, 0.005, 0.006])  # about its own centre [kg m^2]
COULOMB = np.array([4.0, 4.0, 3.0, 1.0, 1.0, 0.5])
VISCOUS = np.array([3.0, 3.0, 2.0, 0.5, 0.5, 0.2])
ROTOR = np.array([3.4, 3.4, 1.15, 0.13, 0.13, 0.05])
STIFF, RUB, WIDTH = 40.0, 0.03, 0.05  # N m/rad, 1, rad/s
AMPLITUDE, OMEGA = np.array([9.0, 8, 5, 1.5, 1.2, 0.6]), np.array([5, 6, 7, 8, 9, 10.0])


def term(name, joint, *values):
    effect = load_effects()[name]
    theta, shape = effect.from_values(np.array(values), ROBOT)
    joints = (joint,) if joint is not None else ()
    return Term(effect, joints, tuple(shape), np.asarray(theta, float))


def load():
    body = find_flange_placement(ROBOT.model).act(pin.Inertia(MASS, LEVER, OWN))
    return Term(load_effects()["payload"], (5,), (), body.toDynamicParameters())


def model(*more):
    terms = [
        term(name, j, values[j])
        for name, values in (("coulomb", COULOMB), ("viscous", VISCOUS), ("rotor_inertia", ROTOR))
        for j in range(6)
    ]
    terms += [load(), term("spring", 2, STIFF, 0.0), *more]
    shapes = (StandstillFriction("smooth", 1.0),) * 6
    floor = np.full(6, WIDTH)
    return Model(ROBOT, read_inertial_parameters(ROBOT.model), tuple(terms), floor, shapes)


def drive(t, q, qd):
    hold = pin.computeGeneralizedGravity(ROBOT.model, ROBOT.model.createData(), q)
    return hold + AMPLITUDE * np.sin(OMEGA * t) - 20.0 * qd


def welded():
    arm = pin.Model(ROBOT.model)
    arm.appendBodyToJoint(6, pin.Inertia(MASS, LEVER, OWN), find_flange_placement(ROBOT.model))
    arm.armature = ROTOR
    return arm


def rate(arm, data, rubs):
    def of(t, x):
        q, qd = x[:6], x[6:]
        turn = np.tanh(qd / WIDTH)
        torque = drive(t, q, qd) - COULOMB * turn - VISCOUS * qd
        torque[2] -= STIFF * q[2]
        qdd = pin.aba(arm, data, q, qd, torque)
        if rubs:
            # Load friction turns with the acceleration that it makes: to a fixed point.
            bare = pin.Model(arm)
            bare.armature = np.zeros(6)
            for _ in range(25):
                load = np.abs(pin.rnea(bare, bare.createData(), q, qd, qdd)[1])
                less = torque.copy()
                less[1] -= RUB * load * turn[1]
                qdd = pin.aba(arm, data, q, qd, less)
        return np.concatenate([qd, qdd])

    return of


def integrated(t):
    arm = welded()
    start = np.concatenate([[0.2, 0.4, 0.3, 0.1, 0.6, 0.0], np.zeros(6)])
    done = solve_ivp(
        rate(arm, arm.createData(), False), (t[0], t[-1]), start, "DOP853", t, rtol=1e-9, atol=1e-10
    )
    return done.y[:6].T, done.y[6:].T


@pytest.mark.parametrize("rubs", [False, True])
def test_the_acceleration_of_a_torque_is_that_of_an_independent_integration(rubs):
    t = np.arange(150) / 500
    q, qd = integrated(t)
    arm, tau = welded(), np.array([drive(*x) for x in zip(t, q, qd, strict=True)])
    of = rate(arm, arm.createData(), rubs)
    wanted = np.array([of(*x)[6:] for x in zip(t, np.hstack([q, qd]), strict=True)])
    whole = model(*((term("load_friction", 1, RUB),) if rubs else ()))
    # |rigid| of this effect is of the arm without its load: so is it given here.
    if rubs:
        bare = whole.inertial.copy()
        bare[-10:] += load().theta
        kept = tuple(x for x in whole.terms if x.effect.name != "payload")
        whole = replace(whole, inertial=bare, terms=kept)
    (track,), _ = build_tracks([Recording("", "irb140", t, q, tau)], whole.filters, None, True)
    rows = [np.abs(t - each).argmin() for each in track.t]
    track = replace(track, q=q[rows], qd=qd[rows], qdd=0 * q[rows])
    got = compute_acceleration(whole, track, tau[rows])
    assert np.abs(wanted).max() > 1.0
    np.testing.assert_allclose(got, wanted[rows], atol=1e-6)


def test_the_mass_matrix_has_the_load_and_the_rotors():
    q = np.random.default_rng(0).uniform(-1, 1, (20, 6))
    arm = welded()
    got = compute_model_mass_matrix(model(), q)
    for each, pose in zip(got, q, strict=True):
        upper = np.triu(pin.crba(arm, arm.createData(), pose))
        np.testing.assert_allclose(each, upper + np.triu(upper, 1).T, atol=1e-9)


# A model that goes by itself under the goal of a log.


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
