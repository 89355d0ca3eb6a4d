"""Fit, evidence, prior and adequacy against regressions written out with numpy."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from residual.diagnosis.adequacy import assess_adequacy
from residual.diagnosis.diagnose import diagnose
from residual.effects import load_effects
from residual.evidence.design import Design
from residual.evidence.fit import FitEquations, count_effective_rows, fit_jointly
from residual.evidence.priors import (
    ASSUMED,
    build_relative_prior,
    compute_inertial_sd,
    screen_candidates,
)
from residual.evidence.priors import list_forbidden_effects as forbidden_effects
from residual.model.model import Model, Term
from residual.model.nominal import GIVEN, NominalModel
from residual.robot.dynamics import read_inertial_parameters as read_inertias
from tests.residual.arms import TWO, arm, plain_logs
from tests.residual.linear import (
    DOF,
    GEAR,
    LINE,
    LOAD,
    NOMINAL,
    OTHER,
    PLANE,
    Problem,
    build,
    every_group,
    random_state,
    track,
)

SIGMA2 = np.array([1.7, 0.4])  # noise variance of each joint, given
SETS = {
    "nominal alone": [],
    "one local": [(LINE, (1,), ())],
    "pair": [(GEAR, (0, 1), ())],
    "all rows": [(LOAD, (1,), ())],
    "several": [(LINE, (0,), ()), (PLANE, (1,), ()), (GEAR, (0, 1), ()), (LOAD, (1,), ())],
}
# The core adds 1e-12 of the diagonal, so that a singular set does not stop it.
EXACT = {"rtol": 1e-7, "atol": 1e-9}


@pytest.fixture
def problem(rng):
    return Problem.draw(rng, [(LINE, (0,), [0.5])], masked=0.2)


def posterior(problem, members, sigma2):
    """Bayesian linear regression in closed form: mean and covariance."""
    x, y, joint = problem.stacked(members)
    noise = sigma2[joint]
    covariance = np.linalg.inv(problem.precision(members) + (x.T / noise) @ x)
    return covariance @ ((x.T / noise) @ y), covariance


def marginal(problem, members, sigma2):
    """Log marginal likelihood: y is Gaussian with covariance X P^-1 X' + noise."""
    x, y, joint = problem.stacked(members)
    covariance = x @ np.linalg.solve(problem.precision(members), x.T)
    covariance += np.diag(sigma2[joint])
    return multivariate_normal.logpdf(y, np.zeros(len(y)), covariance)


def every_row_counts(problem, members, sigma2=None, rounds=1):
    d = problem.design
    return fit_jointly(d, problem.prior, members, d.rows, sigma2, rounds)


@pytest.mark.parametrize("which", SETS)
def test_mean_and_covariance_are_those_of_bayesian_regression(problem, which):
    members = problem.design.add(SETS[which])
    fitted = every_row_counts(problem, members, SIGMA2)
    mean, covariance = posterior(problem, members, SIGMA2)
    np.testing.assert_allclose(fitted.theta, mean, **EXACT)
    np.testing.assert_allclose(fitted.covariance(), covariance, **EXACT)


@pytest.mark.parametrize("which", [k for k in SETS if k != "nominal alone"])
def test_evidence_is_the_difference_of_log_marginal_likelihoods(which, rng):
    """Each set at its own profiled variance, all rows independent.

    The score leaves out what is equal for all sets: constants, and SSE / sigma^2, which
    is the number of rows at the profiled variance but for the noise floor (1e-5).
    """
    problem = Problem.draw(rng, [(LINE, (0,), [0.5])], rows=50, masked=0.2)
    members = problem.design.add(SETS[which])
    big, small = (every_row_counts(problem, m, rounds=60) for m in (members, []))
    expected = marginal(problem, members, big.variance)
    expected -= marginal(problem, [], small.variance)
    assert big.score - small.score == pytest.approx(expected, abs=0.02)


def test_units_of_a_column_do_not_matter_to_its_evidence(problem):
    """Zellner's g-prior: an angle may be in radians or in degrees."""
    thin = replace(LINE, columns=lambda s, j, x: 1e-4 * LINE.columns(s, j, x))
    one, two = (
        every_row_counts(problem, problem.design.add([(e, (0,), ())]), rounds=5)
        for e in (LINE, thin)
    )
    assert one.score == pytest.approx(two.score, abs=1e-6)
    np.testing.assert_allclose(two.theta[-1], 1e4 * one.theta[-1], rtol=1e-6)


def quadratic_gain(problem, base, group):
    scores = []
    for members in ([*base.members, group], base.members):
        x, y, joint = problem.stacked(members)
        share = base.counted[joint] / problem.design.rows[joint]
        w = np.maximum(0.25, share) / base.variance[joint]
        prior = problem.precision(members)
        a = prior + (x.T * w) @ x
        b = (x.T * w) @ y
        log_dets = np.linalg.slogdet(prior)[1] - np.linalg.slogdet(a)[1]
        scores.append(0.5 * b @ np.linalg.solve(a, b) + 0.5 * log_dets)
    return scores[0] - scores[1]


@pytest.mark.parametrize("named", [[], [(OTHER, (0,), ())], [(GEAR, (0, 1), ())]])
def test_the_screen_is_exact_for_every_kind_of_candidate(rng, named, monkeypatch):
    """With noise held at the fit's own; taken from what is left, it is never less."""
    truth = [(LINE, (0,), [2.0]), (LOAD, (1,), [1.0, 0.0, -0.5])]
    problem = Problem.draw(rng, truth, masked=0.2)
    base = every_row_counts(problem, problem.design.add(named), rounds=5)
    groups = every_group(problem.design)
    own = FitEquations.of(problem.design, problem.prior, base.members)
    profiled = screen_candidates(problem.design, base, groups, own)
    monkeypatch.setattr("residual.evidence.priors.NEARLY_ALL", 0.0)
    values = screen_candidates(problem.design, base, groups, own)
    expected = [exact_gain(problem, base, g) for g in groups]
    assert (profiled >= values).all()
    np.testing.assert_allclose(values, expected, rtol=1e-6, atol=1e-6)
    assert values.max() > 5


def exact_gain(problem, base, group):
    if not group.parts:
        return quadratic_gain(problem, base, group)
    # A union has no columns of its own to ask for: its parts, one after the other.
    out, members = 0.0, list(base.members)
    for part in group.parts:
        out += quadratic_gain(problem, replace(base, members=tuple(members)), part)
        members.append(part)
    return out


@pytest.mark.parametrize("a", [0.0, 0.5, 0.8, 0.9])
def test_rows_of_an_autoregression_count_as_theory_says(rng, a):
    """n (1 - a) / (1 + a) for AR(1), n for white noise, within 25 %."""
    problem = Problem.draw(rng, rows=3000, logs=2, colour=a, bend=0.0)
    fitted = every_row_counts(problem, [], rounds=3)
    counted = count_effective_rows(problem.design, fitted)
    expected = problem.design.rows * (1 - a) / (1 + a)
    np.testing.assert_allclose(counted, expected, rtol=0.25)


@pytest.mark.parametrize("colour", [0.0, 0.8])
def test_two_standard_deviations_hold_the_truth_as_often_as_they_should(colour):
    """30 draws each; columns as slow as the noise, or its colour would not matter."""
    inside, uncounted, truth = [], [], [0.7, -0.4]
    for seed in range(30):
        rng = np.random.default_rng(seed)
        problem = Problem.draw(
            rng, [(PLANE, (0,), truth)], rows=200, logs=2, colour=colour, slow=colour
        )
        members = problem.design.add([(PLANE, (0,), ())])
        white = every_row_counts(problem, members, rounds=3)
        counted = count_effective_rows(problem.design, white)
        fitted = fit_jointly(problem.design, problem.prior, members, counted, white.variance)
        for f, out in ((fitted, inside), (white, uncounted)):
            sd = np.sqrt(np.diag(f.covariance()))[-2:]
            out += list(np.abs(f.theta[-2:] - truth) < 2 * sd)
    assert 0.85 <= np.mean(inside) <= 1.0
    # So that the test would notice if rows were taken as independent.
    assert (np.mean(uncounted) < 0.85) == (colour > 0)


# How firmly the nominal model is held, and what it may be blamed for.


FREE, ROUGH_SCALE, FINE_SCALE = None, 0.3, 0.1


def term(name, joint, theta):
    return Term(load_effects()[name], (joint,), (), np.array(theta, dtype=float))


def nominal(terms=(), given=(), **options):
    robot = arm()
    model = Model(robot, read_inertias(robot.model), tuple(terms), np.ones(2))
    return NominalModel(model, tuple(given), **options)


def design_of(found, rng):
    drawn = []
    for k in range(3):
        state = random_state(rng, 100)
        drawn.append((track(rng.normal(size=(100, 2)), np.ones((100, 2), bool), k, state), state))
    return Design([t for t, _ in drawn], found.model, [s for _, s in drawn])


@pytest.mark.parametrize("scale", [0.01, 0.3])
def test_inertial_parameters_are_held_within_a_share_of_their_size(rng, scale):
    """Half of the doubt is each one's own, half the link's as a whole."""
    nominal_model = nominal()
    prior = build_relative_prior(design_of(nominal_model, rng), nominal_model, scale)
    expected = np.zeros((NOMINAL, NOMINAL))
    sizes = compute_inertial_sd(arm()).reshape(2, 10)
    parameters = read_inertias(arm().model).reshape(2, 10)
    for i in range(2):
        own = slice(10 * i, 10 * i + 10)
        shared = np.outer(parameters[i], parameters[i])
        expected[own, own] = 0.5 * scale**2 * (shared + np.diag(sizes[i] ** 2))
    np.testing.assert_allclose(np.linalg.inv(prior.precision), expected, atol=1e-12)
    assert prior.scale == scale
    assert prior.log_det == pytest.approx(np.linalg.slogdet(prior.precision)[1])


@pytest.mark.parametrize(("given", "share"), [(GIVEN, 0.1), (ASSUMED, 1.0)])
def test_a_declared_value_is_held_within_its_share(rng, given, share):
    nominal_model = nominal([term("viscous", 0, [8.0]), term("coulomb", 1, [4.0])], [given, given])
    prior = build_relative_prior(design_of(nominal_model, rng), nominal_model, 0.03)
    sd = 1 / np.sqrt(np.diag(prior.precision))[NOMINAL:]
    # One thousandth of torque rms is added, so that a declared 0 is not exact.
    assert (sd > share * np.array([8.0, 4.0])).all()
    np.testing.assert_allclose(sd, share * np.array([8.0, 4.0]), rtol=0.02)


def test_a_declared_effect_without_value_may_have_all_of_the_torque(rng):
    """Its prior is as wide as the torque that it would explain."""
    nominal_model = nominal([term("viscous", 0, [0.0])], [None])
    design = design_of(nominal_model, rng)
    prior = build_relative_prior(design, nominal_model, 0.03)
    sd = 1 / np.sqrt(prior.precision[-1, -1])
    speed = np.concatenate([s.qd[:, 0] for s in design.states])
    assert sd * np.sqrt(np.mean(speed**2)) == pytest.approx(design.rms[0], rel=1e-3)


@pytest.mark.parametrize(
    ("name", "given", "scale", "barred"),
    [
        # Declared without a value: it is free already, there is nothing to blame.
        ("coulomb", FREE, FINE_SCALE, {"coulomb"}),
        ("coulomb", ASSUMED, FINE_SCALE, {"coulomb"}),
        # Declared with a value: the value may be wrong.
        ("coulomb", GIVEN, FINE_SCALE, set()),
        # A rough rigid body cannot blame a load.
        ("coulomb", GIVEN, ROUGH_SCALE, {"payload", "link_body", "link_inertia"}),
        # What the model has and is no parameter of a model is not named twice.
        ("offset", GIVEN, FINE_SCALE, {"offset"}),
    ],
)
def test_what_may_not_be_blamed(rng, name, given, scale, barred):
    nominal_model = nominal([term(name, 1, [1.0])], [given])
    known = replace(Problem.draw(rng, rows=20).prior, scale=scale)
    prior = replace(known, widths=nominal_model.kinds)
    assert forbidden_effects(prior, nominal_model) == barred


# Is what remains noise, and was the torque channel touched before it was logged?


NOISE = 1.0


def noisy_problem(rng, shape=None, size=0.0, rows=400, noise=NOISE):
    """Noise of 1 N m, known as such, and a torque of some shape on joint 2."""
    drawn = Problem.draw(rng, rows=rows, noise=noise, logs=3)
    logs = []
    for own, state in drawn.logs:
        tau = own.tau.copy()
        if shape is not None:
            tau[:, 1] += size * shape(state)
        logs.append((replace(own, tau=tau, torque_noise=np.full(DOF, noise)), state))
    return Problem(logs, build(logs), drawn.prior)


def judge(found, members=()):
    d = found.design
    before, after = (fit_jointly(d, found.prior, m, d.rows, None, 5) for m in ((), tuple(members)))
    return assess_adequacy(d, tuple(own for own, _ in found.logs), before, after)


def slow(state):
    return np.sqrt(2) * np.sin(state.t / 25)


@pytest.mark.parametrize(
    ("share", "doubted", "flagged"), [(0.01, (), ()), (0.03, (1,), ()), (0.08, (1,), (1,))]
)
def test_a_little_more_than_noise_is_said_and_voids_no_name(share, doubted, flagged):
    """A part of torque on joint 2, where noise is half a per cent of it."""
    rms = noisy_problem(np.random.default_rng(1), noise=0.01).design.rms[1]
    case = noisy_problem(np.random.default_rng(1), slow, share * rms, noise=0.01)
    judgment = judge(case)
    assert (judgment.doubted, judgment.flagged) == (doubted, flagged)


@pytest.mark.parametrize("compared", [False, True])
def test_of_logs_that_show_no_motion_nothing_is_said(compared):
    robot, still = arm(TWO), plain_logs(arm(TWO), [], 0.0, count=3)
    baseline = plain_logs(robot, [0, 1], 0.0) if compared else ()
    verdict = diagnose(robot, still[:2], baseline, still[2:]).verdict
    assert (verdict.verdict, verdict.effects) == ("unknown", ())
    assert "no motion" in " ".join(verdict.contradictions)
