"""What is computed in a quick way, held against the plain way."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import butter, sosfiltfilt

from residual.effects.backlash import _flight
from residual.evidence.fit import FitEquations, fit_jointly
from residual.signals.filters import filter_low_pass
from residual.signals.track import compute_dahl_state
from tests.residual.linear import DOF, Problem, every_group

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
