"""Fit and evidence against regressions written out with numpy."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from residual.evidence.fit import FitEquations, count_effective_rows, fit_jointly
from residual.evidence.priors import screen_candidates
from tests.residual.linear import GEAR, LINE, LOAD, OTHER, PLANE, Problem, every_group

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
