"""Wear from day to day, told from warming up within the day."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from residual.errors import InputError
from residual.identification.identify import identify
from residual.monitoring.wear import friction_of_each, sessions, trends
from tests.residual.arms import arm, plain_logs

DAYS = np.repeat(np.arange(12.0) * 3, 2)
SINCE = np.tile([60.0, 3000.0], 12)  # an early and a late log of each session
TIME = 700.0


def changes(wear=0.0, warming=0.0, seed=0, noise=0.01):
    """Two joints, of which the first wears and both get warm."""
    rng = np.random.default_rng(seed)
    warmth = 1 - np.exp(-SINCE / TIME)
    first = wear * DAYS / 30 + warming * warmth
    return np.column_stack([first, warming * warmth]) + noise * rng.normal(
        size=(len(DAYS), 2)
    )


@given(st.sampled_from([-0.2, 0.08, 0.15]), st.sampled_from([-0.3, -0.15]))
def test_what_was_planted_lies_in_its_interval_and_is_told(wear, warming):
    (first, second), time = trends(changes(wear, warming, noise=0.001), DAYS, SINCE)
    assert first.wear.real
    assert first.warming.real
    assert second.warming.real
    assert first.wear.value == pytest.approx(wear, abs=0.01)
    # Two moments of a session cannot tell the time constant, only what passed between.
    passed = warming * (np.exp(-60 / TIME) - np.exp(-3000 / TIME))
    assert first.warming.value * (
        np.exp(-60 / time) - np.exp(-3000 / time)
    ) == pytest.approx(passed, abs=0.01)


def test_warming_up_is_no_wear_and_wear_no_warming():
    (first, second), _ = trends(changes(warming=-0.3), DAYS, SINCE)
    assert not first.wear.real
    assert not second.wear.real
    (first, second), _ = trends(changes(wear=0.2), DAYS, SINCE)
    assert first.wear.real
    assert not first.warming.real
    assert not second.wear.real


def test_of_friction_that_stays_a_word_is_said_once_in_many_arms():
    said = 0
    for seed in range(50):
        joints, _ = trends(changes(seed=1000 + seed, noise=0.05), DAYS, SINCE)
        said += any(one.wear.real or one.warming.real for one in joints)
    # The time constant is chosen by the same logs, which costs a little.
    assert said <= 2


def test_where_wear_cannot_be_told_it_is_said_why():
    since = 30 + 100 * DAYS
    (first, second), _ = trends(changes(wear=0.2), DAYS, since)
    assert first.wear is None
    assert first.warming is None
    assert "not to be told apart" in second.why
    (first, _), _ = trends(changes(warming=-0.3), np.zeros_like(DAYS), SINCE)
    assert first.wear is None
    assert first.warming.real
    assert first.why == "all logs are of one day"
    values = changes(wear=0.2)
    values[4:, 1] = np.nan
    (_, second), _ = trends(values, DAYS, SINCE)
    assert second.wear is None
    assert second.why == "only 4 logs move it, 6 are needed"
    with pytest.raises(InputError, match="at least 6 are needed, of several days"):
        trends(changes()[:5], DAYS[:5], SINCE[:5])


def test_a_session_ends_where_nothing_was_logged_for_long():
    begins, ends = [0.0, 100.0, 9000.0, 9100.0], [50.0, 150.0, 9050.0, 9150.0]
    assert sessions(begins, ends, 7200.0).tolist() == [0.0, 0.0, 9000.0, 9000.0]
    assert sessions(begins[::-1], ends[::-1], 7200.0).tolist() == [9000, 9000, 0, 0]


def test_each_log_tells_the_friction_that_it_had():
    robot, planted = arm(), np.array([0.8, 1.0, 1.25, 0.9])
    logs = []
    for factor, log in zip(planted, plain_logs(robot, [0, 1], 0.0), strict=True):
        qd = np.gradient(log.q, log.t, axis=0)
        friction = 3 * np.tanh(qd / 0.01) + 2 * qd  # what the logs have, once
        logs.append(replace(log, tau=log.tau + (factor - 1) * friction))
    seen = friction_of_each(robot, logs, identify(robot, logs).model)
    found = 1 + np.array([one.change for one in seen])
    expected = np.tile(planted[:, None], robot.dof) / planted.mean()
    assert found / found.mean(axis=0) == pytest.approx(expected, rel=0.03)


def test_without_friction_in_the_model_there_is_nothing_to_follow():
    robot = arm()
    logs = plain_logs(robot, [0, 1], 0.0, count=2)
    bare = identify(robot, logs, declared=()).model
    with pytest.raises(InputError, match="has no friction, so none can be followed"):
        friction_of_each(robot, logs, bare)
