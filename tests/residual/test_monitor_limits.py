"""Limits keep the promised rate, on values that are alike in time."""

import numpy as np
import pytest
from scipy.signal import lfilter

from residual.monitoring.scores import Scores, channels
from residual.monitoring.usual import (
    BLOCK,
    block_maxima,
    limits_of,
    next_run_limit,
    tail_limit,
)

RATE = 25.0


def noise(seed, seconds, memory=0.9, joints=2):
    """Magnitudes of Gaussian noise with a memory."""
    drive = np.random.default_rng(seed).normal(size=(round(seconds * RATE), joints))
    values = np.abs(lfilter([np.sqrt(1 - memory**2)], [1, -memory], drive, axis=0))
    t = np.arange(len(values)) / RATE
    return Scores("model", t, values, channels(joints, "torque", "torque bias"))


@pytest.mark.parametrize("memory", [0.0, 0.9, 0.99])
def test_false_alarms_are_no_more_than_wanted(memory):
    limits = limits_of([noise(i, 20.0, memory) for i in range(15)], per_hour=1.0)
    hours = 10
    over = noise(99, 3600.0 * hours, memory).values > limits
    blocks = over.any(axis=1).reshape(-1, round(BLOCK * RATE)).any(axis=1)
    assert blocks.sum() <= hours
    assert (limits < 8.0).all()  # and not at the price of seeing nothing


def test_limits_scale_with_the_scores():
    runs = [noise(i, 20.0) for i in range(5)]
    by = np.array([3.0, 100.0])
    larger = [Scores("model", r.t, r.values * by, r.channels) for r in runs]
    np.testing.assert_allclose(limits_of(larger, 1.0), by * limits_of(runs, 1.0))


def test_no_limit_is_below_what_good_runs_showed():
    runs = [noise(i, 20.0) for i in range(5)]
    runs[2].values[100, 1] = 50.0
    assert limits_of(runs, 1000.0)[1] > 50.0


def test_runs_that_differ_make_wider_limits_and_few_runs_too():
    alike, apart = np.full(8, 1.0), np.exp(np.linspace(-0.5, 0.5, 8))
    assert next_run_limit(alike, 1e-3) == pytest.approx(1.0)
    assert next_run_limit(apart, 1e-3) > 3.0
    assert next_run_limit(apart[::3], 1e-3) > next_run_limit(apart, 1e-3)


def test_a_tail_that_ends_is_not_made_longer_than_its_margin():
    assert tail_limit(np.full(20, 2.0), 1e-6) == pytest.approx(3.0)


def test_blocks_are_of_equal_time():
    scores = noise(1, 10.0)
    np.testing.assert_array_equal(
        block_maxima(scores), scores.values.reshape(5, 50, 2).max(axis=1)
    )
