"""The one model type, and the nominal that the user gives."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from residual.diagnosis.diagnose import diagnose
from residual.effects import load_effects
from residual.effects.base import MotionSpan
from residual.errors import InputError, UnknownNameError
from residual.model.model import Model, Term
from residual.model.nominal import DEFAULT_DECLARED, build_nominal
from residual.robot.dynamics import compute_inverse_dynamics, read_inertial_parameters
from residual.robot.robot import load_robot
from tests.residual.arms import SEVEN, arm, recording, smooth_motion

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
