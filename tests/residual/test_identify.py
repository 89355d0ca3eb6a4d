"""Identification: recovery of known parameters, bodies that can exist, unseen logs."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from numpy.testing import assert_allclose

from residual.errors import InputError
from residual.identification import estimate
from residual.identification.estimate import JointRows, Options, build_joint_rows
from residual.identification.identify import find_consistent_parameters, identify
from residual.model.bodies import build_pseudo_inertias, compute_link_eigenvalues
from residual.model.compare import compute_model_errors, prepare_held_out
from residual.model.dynamics import compute_acceleration_error
from residual.model.dynamics import find_least_mass_eigenvalue as least_mass_eigenvalue
from residual.model.model_files import build_robot_folder
from residual.model.nominal import build_free_nominal, prepare_fit_logs
from residual.recording import Recording
from residual.robot.robot import load_robot
from residual.signals.track import FilterSettings
from tests.residual.arms import arm, plain_logs
from tests.residual.identified import COULOMB, ROTOR, VISCOUS, logs, truth

FRICTION = [*VISCOUS, *COULOMB, *ROTOR]


def true(found):
    return found.base.mapping @ np.concatenate([truth().parameters, FRICTION])


@pytest.fixture(scope="module")
def clean():
    return identify(truth().robot, logs())


@pytest.fixture(scope="module")
def noisy():
    return identify(truth().robot, logs(noise=1.0))


def test_without_noise_the_truth_is_found(clean):
    size = np.sqrt(np.diag(clean.base.mapping @ clean.spread @ clean.base.mapping.T))
    assert np.abs((clean.estimate.theta - true(clean)) / size).max() < 2e-3
    assert set(clean.status) == {"fitted"}


def test_errors_are_as_large_as_their_standard_deviation_says(noisy):
    z = (noisy.estimate.theta - true(noisy)) / noisy.estimate.sd
    assert 0.5 < np.sqrt(np.mean(z**2)) < 2.0


def stacked(found):
    rows = build_joint_rows(found.nominal, found.logs.tracks, found.base)
    return rows, np.concatenate(rows.x), np.concatenate(rows.y)


def test_ols_is_ordinary_least_squares():
    identification = identify(truth().robot, logs(noise=1.0), options=Options("ols"))
    _, x, y = stacked(identification)
    theta = np.linalg.lstsq(x, y, rcond=None)[0]
    assert_allclose(identification.estimate.theta, theta, rtol=1e-7, atol=1e-8)


def test_wls_is_least_squares_with_each_joints_weight(noisy):
    rows, x, y = stacked(noisy)
    weight = np.repeat(np.sqrt(noisy.estimate.weight), rows.counts)
    theta = np.linalg.lstsq(x * weight[:, None], y * weight, rcond=None)[0]
    assert_allclose(noisy.estimate.theta, theta, rtol=1e-6, atol=1e-7)
    info = (x * weight[:, None]).T @ (x * weight[:, None])
    assert_allclose(noisy.estimate.sd, np.sqrt(np.diag(np.linalg.inv(info))), rtol=0.05)


def test_outliers_move_least_squares_more_than_the_robust_fit():
    """Bursts of a quarter of a second, that no filter takes away."""
    spoiled = []
    for log in logs(noise=0.5):
        tau = log.tau.copy()
        for start in range(400, len(tau), 700):
            tau[start : start + 60] += 40.0
        spoiled.append(replace(log, tau=tau))
    plain = identify(truth().robot, spoiled)
    robust = identify(truth().robot, spoiled, options=Options("irls"))
    size = np.sqrt(np.diag(plain.base.mapping @ plain.spread @ plain.base.mapping.T))
    miss = [np.linalg.norm((f.estimate.theta - true(f)) / size) for f in (plain, robust)]
    assert miss[1] < 0.5 * miss[0]
    assert robust.estimate.outliers.min() > 0.02


def test_a_joint_that_stands_is_said_and_its_parameters_stay_nominal():
    fit = identify(truth().robot, logs(noise=0.5, joints=(0, 1)))
    assert fit.preflight.standing == (3,)
    held = [one.index for one in fit.preflight.fixed]
    names = [fit.base.leading[i].name for i in held]
    assert "viscous coefficient of joint 3" in names
    np.testing.assert_array_equal(fit.estimate.theta[held], fit.nominal_theta[held])
    assert np.all(fit.estimate.sd[held] == 0)
    lines = " ".join(fit.preflight.lines(fit.base))
    assert "joint 3 never moves" in lines
    assert "viscous coefficient of joint 3 cannot be told" in lines
    assert "it needs motion of joint 3" in lines


def test_a_firm_prior_keeps_the_nominal_and_a_loose_one_the_free_fit(noisy):
    firm, loose = (
        identify(truth().robot, logs(noise=1.0), options=Options(prior=scale))
        for scale in (1e-5, 1e3)
    )
    # Effects without a nominal value stay free, and so does what they are part of.
    rigid = ~np.any(noisy.base.mapping[:, 30:], axis=1)
    theta = firm.estimate.theta[rigid]
    assert_allclose(theta, firm.nominal_theta[rigid], rtol=1e-2, atol=1e-2)
    gap = (loose.estimate.theta - noisy.estimate.theta) / noisy.estimate.sd
    assert np.abs(gap).max() < 0.2
    assert np.all(firm.estimate.sd[rigid] <= noisy.estimate.sd[rigid] * 1.001)


def test_autocorrelation_of_ar1_noise_is_that_of_its_formula(rng):
    a, values = 0.7, rng.normal(size=40_000)
    for i in range(1, len(values)):
        values[i] = a * values[i - 1] + np.sqrt(1 - a**2) * values[i]
    place = np.column_stack([np.zeros(len(values), int), np.arange(len(values))])
    rows = JointRows((values[:, None],), (values,), (place,))
    correlation = estimate.compute_autocorrelation_times(rows, (values,))
    assert correlation[0] == pytest.approx((1 + a) / (1 - a), rel=0.1)


def still(seconds=12.0):
    t = np.arange(round(250 * seconds)) / 250
    return [Recording("still", "any", t, np.ones((len(t), 3)), np.ones((len(t), 3)))]


BAD = {
    "no log": (lambda: identify(truth().robot, []), "No log to identify from"),
    "another arm": (
        lambda: identify(truth().robot, plain_logs(arm(), [0, 1], 0.0, count=1)),
        "has 2 joints, small_arm has 3",
    ),
    "nothing moves": (lambda: identify(truth().robot, still()), "No joint moves in these logs"),
    "too few rows": (
        lambda: identify(truth().robot, logs(1, duration=1.6)),
        r"Too few rows: \d+ moving rows for 22 parameters, expected 66 or more",
    ),
}


@pytest.mark.parametrize("what", BAD)
def test_bad_input_is_told_with_bound_value_and_remedy(what):
    call, message = BAD[what]
    with pytest.raises(InputError, match=message):
        call()


# Consistent bodies, and the way from a model to a URDF and back.


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


# Both directions of a model, and models tried on logs they have not seen.


@pytest.fixture(scope="module")
def identity():
    return identify(truth().robot, logs(noise=0.3))


@pytest.fixture(scope="module")
def held_out():
    return logs(1, noise=0.3, seed=7)


def test_the_identified_model_beats_the_nominal_both_ways(identity, held_out):
    models = {"nominal": identity.nominal, "identified": identity.model}
    nominal = identity.nominal
    torque, _ = compute_model_errors(models, prepare_held_out(held_out, nominal), nominal.filters)
    assert torque["identified"].overall("moving") < 3
    assert torque["identified"].overall("raw") < 0.2 * torque["nominal"].overall("raw")
    both = [compute_acceleration_error(m, held_out).overall("moving") for m in models.values()]
    assert both[1] < 10
    assert both[1] < 0.1 * both[0]


def test_a_joint_that_stands_has_no_acceleration_error(identity):
    error = compute_acceleration_error(identity.model, logs(1, joints=(0, 1)))
    assert np.isnan(error.per_joint("moving")[2])
    assert np.isfinite(error.overall("moving"))


UNPROVABLE = {
    "impossible body": (
        lambda f: compute_acceleration_error(replace(f.model, inertial=-f.model.inertial), logs(1)),
        "expected more than 0: it has no acceleration",
    )
}


@pytest.mark.parametrize("what", UNPROVABLE)
def test_what_cannot_be_validated_is_said(identity, what):
    call, message = UNPROVABLE[what]
    with pytest.raises(InputError, match=message):
        call(identity)
