"""Laws of bodies, angles and reports that are not what the model takes them for.

Every column is held against the thing itself, computed by Pinocchio on the arm, the
motion or the base as they then are.
"""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from residual.effects import load_effects
from residual.effects.base import State
from residual.effects.sensitivity import compute_torque_derivatives
from residual.model.model import Model, Term
from residual.robot import dynamics
from residual.signals.track import FilterSettings, build_tracks
from tests.residual.arms import SEVEN, arm, bare_irb140, recording, smooth_motion

RATE = 200.0
T = np.arange(0, 12, 1 / RATE)
INNER = slice(300, -300)  # away from the ends of the filters
ARMS = {"two": arm, "seven": lambda: arm(SEVEN), "irb140": bare_irb140}


@pytest.fixture(params=sorted(ARMS))
def robot(request):
    return ARMS[request.param]()


def seen(robot, motion=None) -> State:
    """A log of a smooth motion, some friction in the model's torque."""
    q, qd, qdd = smooth_motion(robot, T) if motion is None else motion
    regressor = dynamics.compute_inertial_regressor(robot.model, q, qd, qdd)
    rigid = regressor @ dynamics.read_inertial_parameters(robot.model)
    tau = rigid + 3 * np.sign(qd)
    return State(robot, RATE, T, q, qd, qdd, np.sign(qd), regressor, rigid, tau)


def torque(name, joints, theta, state, shape=()):
    return Term(load_effects()[name], joints, shape, np.atleast_1d(theta)).torque(state)


def moved(state, joint, motion):
    parts = [x.copy() for x in (state.q, state.qd, state.qdd)]
    for part, own in zip(parts, motion, strict=True):
        part[:, joint] = own
    return dynamics.compute_inverse_dynamics(state.robot.model, *parts) - state.rigid


def assert_near(ours, truth, share):
    """Equal but for a share of the truth's rms on each joint."""
    size = np.sqrt(np.mean(truth**2, axis=0)).max()
    assert size > 0
    np.testing.assert_allclose(ours, truth, rtol=0, atol=share * size)


def test_an_encoder_offset_is_the_torque_of_the_arm_where_it_really_is(robot):
    state, angle = seen(robot), 1e-4
    for j in range(1, robot.dof):
        shifted = (state.q[:, j] + angle, state.qd[:, j], state.qdd[:, j])
        ours = torque("encoder_offset", (j,), angle, state)
        assert_near(ours, moved(state, j, shifted), 2e-3)


def test_an_eccentric_encoder_moves_the_arm_with_all_derivatives(robot):
    """True angle x = r + c cos r + s sin r of the reading r, by the chain rule."""
    state, (c, s) = seen(robot), (8e-5, -5e-5)
    for j in range(robot.dof):
        r, rd, rdd = state.q[:, j], state.qd[:, j], state.qdd[:, j]
        x = r + c * np.cos(r) + s * np.sin(r)
        slope = 1 - c * np.sin(r) + s * np.cos(r)
        bend = -c * np.cos(r) - s * np.sin(r)
        true = (x, slope * rd, slope * rdd + bend * rd**2)
        ours = torque("encoder_eccentricity", (j,), (c, s), state)
        assert_near(ours, moved(state, j, true), 2e-3)


def test_an_eccentric_encoder_shakes_the_drive_it_sits_on():
    """Its rotor and its grease feel the true speed, on their own joint alone."""
    state = seen(arm())
    drive = np.array([[3.0, 3.0], [0.5, 0.5]])
    bare, full = (
        torque("encoder_eccentricity", (1,), (0.01, 0.0), x)
        for x in (state, replace(state, drive=drive))
    )
    first = np.gradient(0.01 * np.cos(state.q[:, 1]), 1 / RATE)
    second = np.gradient(first, 1 / RATE)
    own = (full - bare)[INNER, 1]
    assert_near(own[:, None], (3.0 * first + 0.5 * second)[INNER, None], 0.01)
    np.testing.assert_array_equal((full - bare)[:, 0], 0)


def test_a_soft_gear_lags_behind_its_load(robot):
    """The link is where the motor is, less load over stiffness."""
    state, stiffness = seen(robot), 1e6
    theta, _ = load_effects()["elasticity"].from_values(np.array([stiffness]), robot)
    for j in range(robot.dof):
        lag = -state.rigid[:, j] / stiffness
        first = np.gradient(lag, 1 / RATE)
        second = np.gradient(first, 1 / RATE)
        own = (state.q[:, j], state.qd[:, j], state.qdd[:, j])
        true = [a + b for a, b in zip(own, (lag, first, second), strict=True)]
        truth = moved(state, j, true)[INNER]
        ours = torque("elasticity", (j,), theta, state)[INNER]
        if np.abs(truth).max() > 1e-7:
            assert_near(ours, truth, 0.02)


def test_what_a_shift_does_depends_on_the_load_that_the_model_carries():
    """A payload in the model weighs on the derivatives as on the arm."""
    robot = bare_irb140()
    body = pin.Inertia(4.0, np.array([0.1, 0.0, 0.05]), 0.02 * np.eye(3))
    q, _, _ = smooth_motion(robot, T)
    tracks, floor = build_tracks([recording(T, q, 0 * q)], FilterSettings())
    term = Term(load_effects()["payload"], (5,), (), body.toDynamicParameters())
    own = dynamics.read_inertial_parameters(robot.model)
    loaded = pin.Model(robot.model)
    loaded.inertias[6] = loaded.inertias[6] + body
    heavy = dynamics.read_inertial_parameters(loaded)
    with_term = Model(robot, own, (term,), floor).observe(tracks[0])
    in_body = Model(robot, heavy, (), floor).observe(tracks[0])
    np.testing.assert_allclose(
        compute_torque_derivatives(with_term), compute_torque_derivatives(in_body), atol=1e-8
    )


@pytest.mark.parametrize("change", [-3.0, -40.0, -200.0])
def test_derivatives_follow_the_torque_where_a_load_went(change):
    """Pinocchio sums no masses below zero; torque is linear in them all the same."""
    robot = bare_irb140()
    parts = [x[:5] for x in smooth_motion(robot, T)]
    parameters = dynamics.read_inertial_parameters(robot.model)
    parameters[-dynamics.PER_LINK] += change
    state = replace(seen(robot, parts), inertial=parameters)
    ours, step = compute_torque_derivatives(state), 1e-6
    for kind, part in enumerate(parts):
        truth = []
        for j in range(robot.dof):
            sides = []
            for sign in (1, -1):
                near = [x.copy() for x in parts]
                near[kind][:, j] = part[:, j] + sign * step
                y = dynamics.compute_inertial_regressor(robot.model, *near)
                sides.append(y @ parameters)
            truth.append((sides[0] - sides[1]) / (2 * step))
        assert_near(ours[kind], np.stack(truth, axis=-1), 1e-5)


@pytest.mark.parametrize("tilt", [(0.0, 1e-3), (-2e-3, 0.0), (1e-3, 1e-3)])
def test_a_tilted_base_is_gravity_turned(robot, tilt):
    state = seen(robot)
    gravity = robot.model.gravity.linear
    axis = np.cross(gravity, [*tilt, 0.0]) / np.linalg.norm(gravity)
    turned = pin.exp3(axis) @ gravity
    np.testing.assert_allclose(
        (turned - gravity)[:2] / 9.81, tilt, atol=1e-6
    )  # that is how the parameters are meant
    truth = [dynamics.compute_gravity_torque(robot.model, state.q, g) for g in (turned, gravity)]
    ours = torque("base_tilt", (), tilt, state)
    atol = 2e-3 * np.abs(truth[1]).max() * np.abs(tilt).max()
    np.testing.assert_allclose(ours, truth[0] - truth[1], atol=atol)


def test_a_tool_force_is_held_against_by_the_drives(robot):
    """The same force on the last body, in Newton and Euler's own recursion."""
    state, force = seen(robot), np.array([12.0, -7.0, 20.0])
    model, data = robot.model, robot.model.createData()
    frame = dynamics.find_flange_frame(model)
    ours = torque("tool_force", (), force, state)
    for i in range(0, len(T), 400):
        q, qd, qdd = state.q[i], state.qd[i], state.qdd[i]
        pin.framesForwardKinematics(model, data, q)
        placement = model.frames[frame].placement
        local = data.oMf[frame].rotation.T @ force
        push = placement.act(pin.Force(local, np.zeros(3)))
        outside = [pin.Force.Zero() for _ in range(model.njoints)]
        outside[model.nv] = push
        truth = pin.rnea(model, data, q, qd, qdd, outside) - state.rigid[i]
        np.testing.assert_allclose(ours[i], truth, atol=1e-8)


@pytest.mark.parametrize("link", [1, 2])
def test_a_heavier_link_is_the_arm_with_that_body(link):
    robot = arm()
    state, heavier = seen(robot), pin.Model(robot.model)
    body = heavier.inertias[link]
    heavier.inertias[link] = pin.Inertia(1.2 * body.mass, body.lever, 1.2 * body.inertia)
    truth = dynamics.compute_inverse_dynamics(heavier, state.q, state.qd, state.qdd)
    ours = torque("link_inertia", (link - 1,), 0.2, state)
    np.testing.assert_allclose(ours, truth - state.rigid, atol=1e-8)


@pytest.mark.parametrize("late", [0.004, 0.02, -0.01])
def test_a_late_report_is_the_torque_of_a_while_ago(late):
    robot = arm()
    q, qd, qdd = smooth_motion(robot, T)
    state = seen(robot, (q, qd, qdd))
    state = replace(state, tau_model=state.rigid)
    before = seen(robot, smooth_motion(robot, T - late)).rigid
    theta, shape = load_effects()["delay"].from_values(np.array([late]), robot)
    ours = torque("delay", (), theta, state, shape)
    assert_near(ours[INNER], (before - state.rigid)[INNER], 0.01)


def test_a_report_that_ends_is_cut_at_both_sides_and_no_other_has_a_plateau():
    robot = arm()
    state = seen(robot)
    level = 0.6 * np.abs(state.tau_model[:, 0]).max()
    theta, shape = load_effects()["saturation"].from_values(np.array([level]), robot)
    reported = state.tau_model[:, 0] + torque("saturation", (0,), theta, state, shape)[:, 0]
    assert np.abs(reported).max() == pytest.approx(level)
    inside = np.abs(state.tau_model[:, 0]) < level
    np.testing.assert_array_equal(reported[inside], state.tau_model[inside, 0])
    state = seen(arm())
    top = np.abs(state.tau_model).max(axis=0)
    column = torque("saturation", (1,), 1.0, state, (1.01 * top[1],))
    np.testing.assert_array_equal(column, 0)


def test_with_coulomb_friction_bristles_make_dahls_friction():
    robot, ways, level = arm(), 0.02, 4.0
    state = seen(robot)
    both = torque("coulomb", (0,), level, state)
    both = both + torque("presliding", (0,), level, state, (ways,))
    z = both[:, 0] / level
    x, s = state.q[:, 0], np.sign(np.diff(state.q[:, 0]))
    middle = (z[1:] + z[:-1]) / 2
    change = (1 - middle * s) / ways * np.diff(x)  # dz/dx = (1 - z s) / ways
    np.testing.assert_allclose(np.diff(z), change, atol=0.02)
