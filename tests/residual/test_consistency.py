"""Consistent bodies, and the way from a model to a URDF and back."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from residual.errors import InputError
from residual.identification.identify import find_consistent_parameters, identify
from residual.model.bodies import build_pseudo_inertias, compute_link_eigenvalues
from residual.model.dynamics import find_least_mass_eigenvalue as least_mass_eigenvalue
from residual.model.model_files import build_robot_folder
from residual.model.nominal import build_free_nominal, prepare_fit_logs
from residual.robot.robot import load_robot
from residual.signals.track import FilterSettings
from tests.residual.identified import logs, truth

EFFECTS = ("viscous", "coulomb", "rotor_inertia")


@pytest.fixture(scope="module")
def identification():
    return identify(truth().robot, logs(count=1, noise=3.0, duration=8.0))


@pytest.fixture(scope="module")
def bodies(identification):
    return find_consistent_parameters(identification)


def test_free_parameters_are_impossible_bodies_and_consistent_ones_are_not(identification, bodies):
    assert compute_link_eigenvalues(identification.model).min() < 0
    assert bodies.least_eigenvalue.min() > 0
    assert np.all(bodies.model.inertial[::10] > 0)
    for body in bodies.model.inertial.reshape(-1, 10):
        tensor = pin.Inertia.FromDynamicParameters(body).inertia
        first, second, third = np.linalg.eigvalsh(tensor)
        assert first > 0
        assert first + second > third


def test_consistent_bodies_have_a_positive_mass_matrix_and_friction_that_does_not_push(
    bodies, identification
):
    assert bodies.poses == 10_000
    assert bodies.least_mass_matrix > 0
    for term in bodies.model.terms:
        assert np.all(term.theta >= -1e-9)
    estimate = identification.estimate
    free, own = estimate.weight * estimate.counts @ bodies.misfit.T**2
    assert free <= own * (1 + 1e-9)
    assert np.all(bodies.misfit[1] < 1.1 * bodies.misfit[0])


def test_consistent_logs_need_no_price():
    """Without noise the truth is consistent, so the two fits agree."""
    fit = find_consistent_parameters(identify(truth().robot, logs()))
    assert_allclose(fit.misfit[1], fit.misfit[0], rtol=0.05, atol=1e-3)


def test_pseudo_inertia_of_points_is_the_sum_over_them(rng):
    """J = sum m [p; 1] [p; 1]', whatever the points."""
    points, masses = rng.normal(size=(6, 3)), rng.uniform(0.1, 1, 6)
    body = pin.Inertia.Zero()
    for p, m in zip(points, masses, strict=True):
        body += pin.Inertia(m, p, np.zeros((3, 3)))
    homogeneous = np.column_stack([points, np.ones(6)])
    wanted = (homogeneous * masses[:, None]).T @ homogeneous
    pseudo = build_pseudo_inertias(np.array(body.toDynamicParameters()))[0]
    assert_allclose(pseudo, wanted, atol=1e-12)


def test_a_body_without_mass_is_seen_in_the_mass_matrix_and_not_written(identification):
    wrong = identification.model.inertial.copy()
    wrong[20] = -5.0
    wrong = replace(identification.model, inertial=wrong)
    assert least_mass_eigenvalue(wrong) < 0
    wrong = identification.model.inertial.copy()
    wrong[10] = -0.1
    with pytest.raises(InputError, match=r"Link 2 was identified with mass -0\.1 kg"):
        build_robot_folder(replace(identification.model, inertial=wrong))


def test_a_written_model_reloads_to_the_same_torque(bodies, tmp_path):
    model = bodies.model
    for name, content in build_robot_folder(model, "a test").items():
        (tmp_path / name).write_bytes(content)
    robot = load_robot(tmp_path)
    again = build_free_nominal(
        prepare_fit_logs(robot, logs(1), None, FilterSettings()), EFFECTS
    ).model
    again = replace(again, speed_floor=model.speed_floor, standstill=model.standstill)
    new = logs(1, seed=9)[0]
    assert_allclose(again.predict(new), model.predict(new), rtol=0, atol=1e-9)
