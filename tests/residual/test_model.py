"""The one model type, friction at standstill, and quick forms held against plain ones."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.signal import butter, sosfiltfilt

from residual.diagnosis.diagnose import diagnose
from residual.effects import load_effects
from residual.effects.backlash import _flight
from residual.effects.base import MotionSpan
from residual.errors import InputError, UnknownNameError
from residual.evidence.fit import FitEquations, fit_jointly
from residual.model.model import Model, Term
from residual.model.nominal import DEFAULT_DECLARED, build_nominal, choose_standstill_behaviour
from residual.robot.dynamics import compute_inverse_dynamics, read_inertial_parameters
from residual.robot.robot import load_robot
from residual.signals.filters import filter_low_pass
from residual.signals.track import (
    CHOICES,
    SMOOTH,
    StandstillFriction,
    build_tracks,
    compute_dahl_state,
)
from residual.signals.track import compute_friction_direction as friction_direction
from tests.residual.arms import SEVEN, arm, recording, smooth_motion
from tests.residual.linear import DOF, Problem, every_group

# The one model type, and the nominal that the user gives.


FLOOR = 0.01


def nominal(robot, names):
    span = MotionSpan(np.full(robot.dof, 1.0), np.full(robot.dof, 2.0), 0.0, 8.0)
    return build_nominal(robot, names, span, floor(robot))


def floor(robot):
    return np.full(robot.dof, FLOOR)


def log_of(robot, t):
    q, qd, qdd = smooth_motion(robot, t)
    return recording(t, q, compute_inverse_dynamics(robot.model, q, qd, qdd)), qd


def test_nominal_irb140_is_rnea_plus_the_friction_that_it_declares():
    robot = load_robot("irb140")
    t = np.arange(1500) / 250
    log, qd = log_of(robot, t)
    declared = {n: robot.declared[n].values for n in DEFAULT_DECLARED}
    _, _, qdd = smooth_motion(robot, t)
    expected = (
        log.tau
        + declared["viscous"]["coefficient"] * qd
        + declared["coulomb"]["level"] * np.sign(qd)
        + declared["rotor_inertia"]["inertia"] * qdd
    )
    torque = nominal(robot, DEFAULT_DECLARED).model.predict(log)
    moving = ((t > 0.5) & (t < 5.5))[:, None] & (np.abs(qd) > 5 * FLOOR)
    gap = (torque - expected)[moving]
    assert np.sqrt(np.mean(gap**2)) < 2e-3 * np.sqrt(np.mean(expected[moving] ** 2))


def test_a_prediction_stands_at_the_samples_of_the_log_however_they_are_spaced():
    robot = arm()
    even = np.arange(1500) / 250
    rng = np.random.default_rng(1)
    t = 100 + np.sort(even + rng.uniform(-0.0015, 0.0015, len(even)))
    t = np.delete(t, rng.choice(np.arange(1, 1499), 100, replace=False))
    log, _ = log_of(robot, t)
    torque = nominal(robot, ()).model.predict(log)
    assert torque.shape == log.tau.shape
    inside = (t > t[0] + 0.5) & (t < t[-1] - 0.5)
    gap = np.linalg.norm((torque - log.tau)[inside])
    assert gap < 5e-3 * np.linalg.norm(log.tau[inside])


def some_model(robot, seed=0):
    rng = np.random.default_rng(seed)
    places = [("coulomb", (0,), ()), ("spring", (0,), ())]
    places.insert(1, ("stribeck", (1,), (0.1, 2.0)))
    widths = (1, 1, 2)
    terms = tuple(
        Term(load_effects()[n], joints, shape, rng.normal(size=k))
        for (n, joints, shape), k in zip(places, widths, strict=True)
    )
    return Model(robot, read_inertial_parameters(robot.model), terms, floor(robot))


def test_torque_is_the_sum_of_the_rigid_body_and_each_term():
    robot = arm()
    model = some_model(robot)
    log, _ = log_of(robot, np.arange(750) / 250)
    rigid = replace(model, terms=())
    alone = [replace(model, inertial=0 * model.inertial, terms=(t,)) for t in model.terms]
    parts = [m.predict(log) for m in (rigid, *alone)]
    assert_allclose(model.predict(log), sum(parts), atol=1e-9)


def test_a_torque_gain_scales_everything_but_itself():
    robot = arm()
    model = some_model(robot)
    gain = Term(load_effects()["torque_gain"], (1,), (), np.array([0.1]))
    log, _ = log_of(robot, np.arange(750) / 250)
    for terms in ((*model.terms, gain), (gain, *model.terms)):
        scaled = replace(model, terms=terms).predict(log)
        assert_allclose(scaled, model.predict(log) * [1.0, 1.1], rtol=1e-9, atol=1e-9)


WITHOUT_SHAPE = {
    "warmup": "[declared.warmup]\nlevel = [2, 2]\n",
    "stribeck": "[declared.stribeck]\nlevel = [2, 2]\n",
    "ripple": "[declared.ripple]\namplitude = [1, 1]\n",
    "power_viscous": "[declared.power_viscous]\ncoefficient = [1, 1]\n",
}


@pytest.mark.parametrize("name", sorted(WITHOUT_SHAPE))
def test_declared_values_without_their_shape_are_refused(name):
    with pytest.raises(InputError, match=r"time_constant|velocity|order|exponent"):
        nominal(arm(toml=WITHOUT_SHAPE[name]), (name,))


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("coulom", "did you mean 'coulomb'"),
        ("Viscous", "did you mean 'viscous'"),
        ("sprng", "did you mean 'spring'"),
        ("xyzzy", "Valid: backlash, balancer"),
    ],
)
def test_an_unknown_effect_is_answered_with_the_nearest(name, hint):
    log, _ = log_of(arm(), np.arange(750) / 250)
    with pytest.raises(UnknownNameError, match=hint):
        diagnose(arm(), [log], declared=[name])


@pytest.mark.parametrize("where", ["fit", "baseline", "held_out"])
def test_a_log_of_another_robot_is_refused_wherever_it_is_given(where):
    t = np.arange(750) / 250
    good, _ = log_of(arm(), t)
    bad, _ = log_of(arm(SEVEN), t)
    logs = {"fit": [good], "baseline": [], "held_out": []}
    logs[where] = [replace(bad, id="b")]
    with pytest.raises(InputError, match="b has 7 joints, small_arm has 2"):
        diagnose(arm(), **logs)


# What the direction of motion does while a joint stands.


SPEED_FLOOR = 0.02


def motion(seed=0, n=400):
    """A wandering joint with stops; velocity at 100 Hz."""
    rng = np.random.default_rng(seed)
    steps = rng.normal(size=n) * 1e-3 * (rng.uniform(size=n) > 0.3)
    q = np.cumsum(np.convolve(steps, np.ones(9) / 9, "same"))
    return q, np.gradient(q, 0.01)


@pytest.mark.parametrize("shape", CHOICES, ids=str)
@settings(max_examples=10)
@given(seed=st.integers(0, 2000))
def test_direction_stays_within_one_and_turns_round_with_the_motion(shape, seed):
    q, qd = motion(seed)
    out = friction_direction(q, qd, SPEED_FLOOR, shape)
    assert out.shape == q.shape
    assert np.abs(out).max() <= 1
    assert_allclose(friction_direction(-q, -qd, SPEED_FLOOR, shape), -out, atol=1e-12)


@pytest.mark.parametrize("shape", CHOICES, ids=str)
def test_direction_is_the_sign_of_speed_in_steady_motion(shape):
    t = np.arange(300) / 100
    out = friction_direction(-2.0 * t, np.full(300, -2.0), SPEED_FLOOR, shape)
    assert_allclose(out[100:], -1, atol=1e-3)


@pytest.mark.parametrize("shape", CHOICES, ids=str)
@pytest.mark.parametrize("hold", [0.0, 0.4, 1.0])
def test_the_share_held_counts_only_while_the_joint_stands(shape, hold):
    q, qd = motion()
    full = friction_direction(q, qd, SPEED_FLOOR, replace(shape, hold=1.0))
    held = friction_direction(q, qd, SPEED_FLOOR, replace(shape, hold=hold))
    stands = np.abs(qd) < shape.reach * SPEED_FLOOR
    assert stands.any()
    assert not stands.all()
    assert_allclose(held[stands], hold * full[stands])
    np.testing.assert_array_equal(held[~stands], full[~stands])


def stop_and_go(dof=2):
    t = np.arange(2500) / 250
    speed = np.stack([np.where((t + j) % 2.5 < 1.5, 0.6, 0.0) for j in range(dof)], 1)
    speed *= np.where(t < 5, 1.0, -1.0)[:, None]
    return t, np.cumsum(speed, axis=0) / 250


@pytest.mark.parametrize("hold", [0.0, 0.3, 0.8])
def test_the_share_that_friction_holds_at_standstill_is_read_from_the_fit_logs(hold):
    """Joint 1 has friction that holds that share; joint 2 has none, so stays as is."""
    robot = arm()
    t, q = stop_and_go()
    friction = Term(load_effects()["coulomb"], (0,), (), np.array([5.0]))
    model = Model(
        robot, read_inertial_parameters(robot.model), (friction,), np.full(2, SPEED_FLOOR)
    )
    truth = replace(model, standstill=2 * (StandstillFriction("bristle", 1e-3, hold=hold),))
    log = recording(t, q, truth.predict(recording(t, q, 0 * q)))
    tracks, _ = build_tracks([log], model.filters, model.speed_floor)
    settled = choose_standstill_behaviour(model, tracks)
    assert settled.standstill[0].hold == pytest.approx(hold, abs=0.06)
    assert settled.standstill[1] == SMOOTH
    before, after = (np.linalg.norm((m.predict(log) - log.tau)[200:-200]) for m in (model, settled))
    assert after <= before + 1e-12


# What is computed in a quick way, held against the plain way.


SEEDS = st.integers(0, 2**32 - 1)


def walk(seed, n, columns=1):
    return np.cumsum(np.random.default_rng(seed).normal(size=(n, columns)), axis=0)


@pytest.mark.parametrize("rate", [94, 125, 250, 1000])
@pytest.mark.parametrize("step", [1, 4])
def test_the_low_pass_is_that_of_scipy_and_every_step_of_it(rate, step):
    x, cutoff = walk(1, 6 * rate, 3), min(8.0, 0.08 * rate)
    sections = butter(4, cutoff / (rate / 2), output="sos")
    theirs = sosfiltfilt(sections, x, axis=0, padlen=rate)[::step]
    # What it forgets after 4.5 periods is 1e-6 of the span.
    np.testing.assert_allclose(
        filter_low_pass(x, cutoff, rate, step), theirs, atol=5e-6 * np.ptp(x)
    )


@pytest.mark.parametrize("order", [1, 2])
def test_a_derivative_is_the_central_difference_of_the_low_pass(order):
    x, rate, step = walk(2, 1500, 2), 250.0, 2
    theirs = filter_low_pass(x, 12.0, rate)
    for _ in range(order):
        theirs = np.gradient(theirs, 1 / rate, axis=0)
    ours = filter_low_pass(x, 12.0, rate, step, order=order)
    inside = slice(3, -3)
    size = np.abs(theirs).max()
    np.testing.assert_allclose(ours[inside], theirs[::step][inside], atol=1e-9 * size)


@given(SEEDS, st.integers(1, 400), st.sampled_from([3e-5, 1e-3, 5e-2]))
def test_a_bristle_is_dahls_state_step_by_step(seed, n, displacement):
    q, state = 1e-3 * walk(seed, n)[:, 0], np.zeros(n)
    for i in range(1, n):
        step = q[i] - q[i - 1]
        goal = 1.0 if step > 0 else -1.0
        state[i] = goal + (state[i - 1] - goal) * np.exp(-abs(step) / displacement)
    np.testing.assert_allclose(compute_dahl_state(q, displacement), state, atol=1e-12)


@given(SEEDS, st.integers(1, 400), st.sampled_from([0.1, 1.0, 10.0]))
def test_a_link_flies_as_step_by_step(seed, n, strong):
    push, gap, dt = strong * walk(seed, n)[:, 0], 1e-3, 1 / 125
    plain, x, v = np.empty(n), gap * np.sign(push[0]), 0.0
    for i in range(n):
        v += dt * push[i]
        x += dt * v
        if abs(x) >= gap:
            x, v = gap * np.sign(x), 0.0
        plain[i] = x
    np.testing.assert_allclose(_flight(push, gap, dt), plain, atol=1e-12)


@given(SEEDS)
def test_a_set_with_one_more_is_gathered_or_grown_alike(seed):
    problem = Problem.draw(np.random.default_rng(seed), rows=60)
    design, groups = problem.design, every_group(problem.design)
    grown = FitEquations.of(design, problem.prior, groups[:1])
    for group in groups[1:3]:
        grown = grown.beside(design, group)
    gathered = FitEquations.of(design, problem.prior, groups[:3])
    for name in ("ids", "precision", "gram", "cross", "power"):
        np.testing.assert_allclose(getattr(grown, name), getattr(gathered, name))
    every, have = design.present(0, gathered.ids)
    gram, cross = design.fold_sums(0, every)
    own = gathered.gram[0][np.ix_(have, have)]
    np.testing.assert_allclose(gram.sum(axis=0), own, atol=1e-9)
    theta = np.random.default_rng(seed).normal(size=len(every))
    left = cross - gram @ theta
    np.testing.assert_allclose(design.fold_pulls(0, every, theta), left, atol=1e-9)
    counted = np.full(DOF, 50.0)
    one, other = (
        fit_jointly(design, problem.prior, groups[:3], counted, system=s) for s in (grown, None)
    )
    assert one.score == pytest.approx(other.score)
