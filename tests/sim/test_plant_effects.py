"""Each effect shows where and as its level says."""

from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.ndimage import uniform_filter1d

from sim.plant import step_tables as at
from sim.plant.closed_loop import build_open_loop_controller as open_loop_controller
from sim.plant.drive_train_step import solve_friction_impulses
from sim.plant.effect_catalogue import resolve_effects
from sim.plant.sensors import simulate_torque_report
from tests.sim.plant_cases import ROBOT, drive, effect, motion, standing

pytestmark = pytest.mark.usefixtures("compiled_plant")

MOVE = motion("move_stop_move", 4.0)


@cache
def plain():
    return drive(reference=MOVE)


def friction(trace, joint):
    rows = trace.rows[:, :, joint - 1]
    moving = np.abs(rows[:, at.QD]) > 0.02
    return rows[moving, at.FRICTION], rows[moving, at.QD], rows[moving]


def channel(trace, name):
    return trace.rows[:, at.CHANNELS + trace.channels.index(name)]


def fit(columns, torque):
    return np.linalg.lstsq(np.column_stack(columns), torque, rcond=None)[0]


def test_a_standing_arm_does_not_creep():
    reference = standing(5.0)
    hold = drive(reference=motion("move_stop_move", 1.0), scatter=0.0).rigid(1)[0]
    push = 0.5 + 0.3 * np.sin(2 * np.pi * 3 * reference.t[:, None])
    start = standing(5.0, q=motion("move_stop_move", 1.0).q[0])
    given = hold + push * np.array([12, 12, 8, 3, 3, 1.5])
    trace = drive(reference=start, controller=open_loop_controller(given), scatter=0.0)
    assert np.abs(trace.rows[:, at.Q] - start.q).max() < 1e-12


def test_dry_friction_solves_its_complementarity():
    rng = np.random.default_rng(0)
    for _ in range(50):
        a = rng.normal(size=(5, 5))
        coupling, free = a @ a.T + 0.1 * np.eye(5), rng.normal(size=5)
        forward, backward = rng.uniform(0, 1, (2, 5))
        impulse = np.zeros(5)
        solve_friction_impulses(coupling, free, forward, backward, impulse)
        u = free + coupling @ impulse
        inside = (impulse > -forward) & (impulse < backward)
        assert np.abs(u[inside]).max(initial=0.0) < 1e-9
        assert (u[impulse == -forward] > -1e-9).all()
        assert (u[impulse == backward] < 1e-9).all()


@pytest.mark.parametrize(
    ("hidden", "column", "size"),
    [
        (effect("coulomb", 2, level=5.0), np.sign, 5.0),
        (effect("viscous", 2, coefficient=4.0), lambda v: v, 4.0),
        (effect("coulomb_asymmetry", 2, level=3.0), np.ones_like, 3.0),
        (effect("viscous_asymmetry", 2, coefficient=3.0), np.abs, 3.0),
        (effect("quadratic_viscous", 2, coefficient=2.0), lambda v: v * abs(v), 2.0),
    ],
)
def test_friction_has_the_size_that_was_asked_for(hidden, column, size):
    torque, v, _ = friction(drive(hidden, reference=MOVE, scatter=0.0), 2)
    extra = torque - 12.0 * np.sign(v) - 8.0 * v
    assert fit([column(v)], extra)[0] == pytest.approx(size, rel=0.03)


def test_stribeck_friction_fades_with_speed():
    hidden = effect("stribeck", 2, level=6.0, velocity=0.1)
    torque, v, _ = friction(drive(hidden, reference=MOVE, scatter=0.0), 2)
    extra = (torque - 12.0 * np.sign(v) - 8.0 * v) * np.sign(v)
    assert_allclose(extra, 6.0 / (1 + (v / 0.1) ** 2), atol=0.6)


def test_load_friction_follows_the_torque_of_the_gear():
    hidden = effect("load_friction", 2, coefficient=0.1)
    torque, v, rows = friction(drive(hidden, reference=MOVE, scatter=0.0), 2)
    extra = (torque - 12.0 * np.sign(v) - 8.0 * v) * np.sign(v)
    load = np.hypot(rows[:, at.GEAR], 1.2)
    assert fit([load], extra)[0] == pytest.approx(0.1, rel=0.02)


def test_a_shared_gear_rubs_on_both_joints():
    values = {"level": 1.0, "coefficient": 0.2, "inertia": 0.01, "sign": -1.0}
    hidden = effect("coupled_friction", (5, 6), **values)
    trace = drive(hidden, reference=MOVE, scatter=0.0)
    base = trace.rows[:, at.QD] * [8, 8, 5, 1, 1, 0.5]
    base += np.sign(trace.rows[:, at.QD]) * [12, 12, 8, 3, 3, 1.5]
    moving = (np.abs(trace.rows[:, at.QD, 4:]) > 0.02).all(axis=1)
    extra = (trace.rows[:, at.FRICTION] - base)[moving]
    u = trace.rows[moving, at.QD, 4] - trace.rows[moving, at.QD, 5]
    fast = np.abs(u) > 0.05
    assert_allclose(extra[:, 4], -extra[:, 5], atol=0.02)
    change = (trace.qdd[moving, 4] - trace.qdd[moving, 5])[fast]
    parameters = fit([np.sign(u)[fast], u[fast], change], extra[fast, 4])
    assert_allclose(parameters, [1.0, 0.2, 0.01], rtol=0.15)


def test_bristles_yield_before_they_slide():
    hidden = effect("presliding", 2, level=12.0, displacement=0.01)
    _, v, rows = friction(drive(hidden, reference=MOVE, scatter=0.0), 2)
    z = (rows[:, at.FRICTION] - 8.0 * v) / 12.0
    assert np.abs(z).max() < 1.2
    settled = np.abs(v) > 0.6
    assert_allclose(z[settled], np.sign(v[settled]), atol=0.15)


def test_warmup_friction_fades_as_work_heats_the_gear():
    hidden = effect("warmup", 1, level=6.0, time_constant=60.0)
    work = motion("fourier", 6.0)
    cold, warm = (drive(hidden, reference=work, start=s) for s in (0.0, 300.0))
    sizes = [np.abs(friction(x, 1)[0]).mean() for x in (cold, warm)]
    assert sizes[0] - sizes[1] == pytest.approx(6.0, rel=0.2)
    heat = cold.rows[:, at.TEMPERATURE, 0]
    assert heat[0] == 20.0
    assert heat[-1] > 20.5


def test_joint_springs_and_magnets_resist_as_stated():
    effects = (
        effect("offset", 1, torque=2.0),
        effect("spring", 2, stiffness=5.0, rest=0.2),
        effect("balancer", 3, cos=3.0, sin=-4.0),
        effect("ripple", 4, amplitude=0.5, order=12.0, phase=0.3),
    )
    trace = drive(*effects, reference=MOVE)
    q = trace.rows[:, at.Q]
    assert (channel(trace, "offset")[:, 0] == 2.0).all()
    assert_allclose(channel(trace, "spring")[:, 1], 5 * (q[:, 1] - 0.2), rtol=0.1, atol=0.01)
    gas = 3 * np.cos(q[:, 2]) - 4 * np.sin(q[:, 2])
    assert_allclose(channel(trace, "balancer")[:, 2], gas, atol=0.8)
    wave = 0.5 * np.cos(12 * q[:, 3] + 0.3)
    assert_allclose(channel(trace, "ripple")[:, 3], wave, atol=0.08)


def test_a_force_on_the_tool_lifts_or_loads_the_arm():
    trace = drive(effect("tool_force", z=-20.0), reference=standing(0.2))
    # A push down takes torque of the same sign as weight, by a lever of about 0.5 m.
    push = channel(trace, "tool_force")[-1, 1]
    assert np.sign(push) == np.sign(trace.rigid(1)[-1, 1])
    assert 8.0 < abs(push) < 12.0


def test_a_spring_in_the_gear_gives_way_to_the_load_and_play_is_as_wide_as_stated():
    trace = drive(effect("elasticity", 2, stiffness=8000.0), reference=MOVE)
    rows = trace.rows[300:, :, 1]
    twist = rows[:, at.MOTOR_Q] - rows[:, at.Q]
    assert fit([rows[:, at.GEAR]], twist)[0] == pytest.approx(1 / 8000, rel=0.02)
    # The controller sees the motor.
    assert_array_equal(rows[:, at.READING], rows[:, at.MOTOR_Q])
    trace = drive(effect("backlash", 1, half_gap=0.002), reference=MOVE)
    twist = trace.rows[:, at.MOTOR_Q, 0] - trace.rows[:, at.Q, 0]
    assert 0.0019 < twist.max() < 0.0024
    assert -0.0024 < twist.min() < -0.0019
    trace = drive(effect("elasticity", (4, 5, 6), stiffness=3000.0), reference=MOVE)
    assert np.abs(trace.rows[:, at.READING] - MOVE.q).max() < 0.03


@pytest.mark.parametrize("load", [0.0, 6.0])
def test_soft_gears_are_stable_at_one_kilohertz(load):
    effects = [
        effect("elasticity", (1, 2, 3), stiffness=12000.0),
        effect("backlash", (1, 2, 3), half_gap=2e-4),
    ]
    if load:
        effects.append(effect("payload", 6, mass=load, com_x=0.1))
    reference = motion("fourier", 8.0)
    trace = drive(*effects, reference=reference)
    astray = trace.rows[1000:, at.READING_RATE, :3] - reference.qd[1000:, :3]
    mean = uniform_filter1d(astray, 50, axis=0)
    assert np.abs(mean).max() < 0.2
    assert (astray - mean).std(axis=0).max() < 0.01  # it does not hum


def test_the_controller_believes_a_wrong_or_eccentric_encoder():
    hidden = effect("encoder_offset", 2, angle=0.02)
    rows = drive(hidden, reference=MOVE).rows
    assert_allclose(rows[:, at.Q, 1] - rows[:, at.READING, 1], 0.02)
    assert np.abs(rows[:, at.READING, 1] - MOVE.q[:, 1]).max() < 0.003
    hidden = effect("encoder_eccentricity", 1, cos=0.01, sin=0.005)
    rows = drive(hidden, reference=MOVE).rows[:, :, 0]
    wave = 0.01 * np.cos(rows[:, at.Q]) + 0.005 * np.sin(rows[:, at.Q])
    assert_allclose(rows[:, at.Q] - rows[:, at.READING], wave, atol=1e-12)
    rate = np.gradient(rows[:, at.READING], 1e-3)
    assert_allclose(rate[5:-5], rows[5:-5, at.READING_RATE], atol=0.02)


def test_a_drive_has_a_wrong_torque_constant_in_the_loop_and_a_limit():
    rows = drive(effect("torque_gain", 3, gain=0.1), reference=MOVE).rows
    assert_allclose(rows[:, at.DRIVE, 2], 1.1 * rows[:, at.MOTOR, 2])
    assert_array_equal(rows[:, at.DRIVE, 1], rows[:, at.MOTOR, 1])
    given = np.full((50, 6), 1e4)
    given[:, 1:] = 0.0
    trace = drive(reference=standing(0.05), controller=open_loop_controller(given))
    assert trace.rows[:, at.DRIVE, 0].max() == ROBOT.torque_limit[0]


def test_reports_of_torque_come_late_and_end_at_their_range():
    t = np.arange(1000) / 1000
    torque = np.column_stack([10 * np.sin(6 * t), 5 * np.cos(4 * t)])
    late = simulate_torque_report(torque, t, resolve_effects([effect("delay", delay=0.0105)]))
    assert_allclose(late[20:, 0], 10 * np.sin(6 * (t[20:] - 0.0105)), atol=1e-3)
    short = simulate_torque_report(torque, t, resolve_effects([effect("saturation", 1, level=4.0)]))
    assert np.abs(short[:, 0]).max() == 4.0
    assert_array_equal(short[:, 1], torque[:, 1])


@pytest.mark.parametrize(
    "hidden",
    [
        effect("payload", 6, 0.5, mass=3.0, com_x=0.1),
        effect("elasticity", 2, 0.5, stiffness=9000.0),
        effect("coulomb", 2, 0.5, level=6.0),
        effect("x_vibration", 2, 0.5, amplitude=5.0, frequency=4.0),
    ],
)
def test_nothing_happens_before_the_onset(hidden):
    with_it = drive(hidden, reference=MOVE).rows
    without = plain().rows
    assert_array_equal(with_it[:500, : at.CHANNELS], without[:500, : at.CHANNELS])
    assert np.abs(with_it[500:, at.DRIVE] - without[500:, at.DRIVE]).max() > 1.0
