"""What the logs say of a value alone, and sets of effects that are as good."""

import numpy as np
import pytest

from residual.diagnosis.changes import _Asked, _State, _told
from residual.diagnosis.sets import _score, best_set, rivals
from tests.residual.linear import GEAR, LINE, OTHER, PLANE, Problem


def known(values, before):
    """Posterior of values of which logs hold so much: mean and covariance."""
    information, pull = values
    after = np.linalg.inv(np.linalg.inv(before) + information)
    return after @ pull, after


@pytest.mark.parametrize("count", [1, 3])
def test_a_value_is_asked_without_its_own_prior(rng, count):
    """With the prior of the values taken away it is what weighted least squares say."""
    mix = rng.normal(size=(5, 5))
    information, truth = mix @ mix.T + np.eye(5), rng.normal(size=5)
    before = np.diag(rng.uniform(0.5, 2.0, size=5))
    theta, after = known((information, information @ truth), before)
    state = _State(theta, before, after, np.zeros((5, 5)))
    rows = np.eye(5)[:count]
    names = tuple((f"v{i}", (1,), "k", "1") for i in range(count))
    asked = _Asked(names, np.zeros(count), np.ones(count), rows, rows)
    said = list(_told(state, asked, 3.0))
    free = np.linalg.inv(before)
    free[:count, :count] = 0.0
    expected = np.linalg.inv(free + information)
    mean = (expected @ (information @ truth))[:count]
    np.testing.assert_allclose([c.identified for c in said], mean, rtol=1e-9)
    sd = np.sqrt(np.diag(expected))[:count]
    np.testing.assert_allclose([c.std for c in said], sd, rtol=1e-9)


def test_a_value_of_which_the_logs_hold_nothing_is_never_off():
    before = after = np.eye(2)
    state = _State(np.array([0.0, 0.0]), before, after, np.zeros((2, 2)))
    rows = np.eye(2)[:1]
    names = (("v", (1,), "k", "1"),)
    (said,) = _told(state, _Asked(names, np.ones(1), np.ones(1), rows, rows), 3.0)
    assert not said.beyond
    assert said.std > 50


@pytest.mark.parametrize(
    ("added", "before", "told"),
    [([[1.0, 0.0]], [0.0025, 1.0], False), ([[1.0, 1.0]], [1e-6, 1.0], True)],
    ids=["no finding on it", "a finding says it"],
)
def test_only_a_finding_explains_a_value_that_is_off(added, before, told):
    """What its prior held back of a value is as little explained as the rest."""
    row, before = np.array(added), np.diag(before)
    theta, after = known((400 * row.T @ row, 400 * 0.25 * row[0]), before)
    state = _State(theta, before, after, np.zeros((2, 2)))
    slope, names = np.eye(2)[:1, :1], (("v", (1,), "k", "1"),)
    (said,) = _told(state, _Asked(names, np.ones(1), np.ones(1), slope, row), 3.0)
    assert said.identified == pytest.approx(1.25, abs=1e-3)
    assert abs(theta[0]) < 3 * said.std  # the fit alone would not show it
    assert (said.beyond, said.explained) == (True, told)


def every(problem, effects):
    return [
        group
        for effect in effects
        for joints in effect.candidates(2)
        for group in problem.design.add([(effect, joints, ())])
    ]


def places(fitted):
    return sorted((g.effect.name, g.joints) for g in fitted.members)


def test_two_names_give_way_to_the_one_that_does_what_both_do(rng):
    """A plane is a line of speed and one of acceleration: one name says both."""
    problem = Problem.draw(rng, [(PLANE, (0,), [3.0, 3.0])], rows=300, noise=0.3)
    groups = every(problem, (LINE, OTHER, PLANE, GEAR))
    task = problem.task(groups)
    by_name = {(g.effect.name, g.joints): g for g in groups}
    wrong = [by_name["other", (0,)], by_name["line", (0,)], by_name["plane", (0,)]]
    start = task.settle(task.fit(wrong, task.start()))
    found = best_set(task, start)
    assert places(found) == [("plane", (0,))]
    assert _score(task, found) > _score(task, start)


def test_one_name_gives_way_to_the_two_that_are_there(rng):
    truth = [(LINE, (0,), [3.0]), (OTHER, (0,), [3.0])]
    problem = Problem.draw(rng, truth, rows=300, noise=0.3)
    groups = every(problem, (LINE, OTHER, GEAR))
    task = problem.task(groups)
    gear = next(g for g in groups if g.effect is GEAR)
    start = task.settle(task.fit([gear], task.start()))
    assert places(best_set(task, start)) == [("line", (0,)), ("other", (0,))]


def test_sets_as_good_are_listed_and_far_ones_are_not(rng):
    truth = [(LINE, (0,), [3.0]), (OTHER, (1,), [3.0])]
    problem = Problem.draw(rng, truth, rows=300)
    task = problem.task(every(problem, (LINE, OTHER, PLANE)))
    wanted = [("line", (0,)), ("other", (1,))]
    groups = task.candidates.groups
    named = [g for g in groups if (g.effect.name, g.joints) in wanted]
    fitted = task.settle(task.fit(named, task.start()))
    found = rivals(task, fitted, ())
    assert all(r.nats > -6 for r in found)
    told = [places(r) for r in found]
    # The plane holds the speed as well; a line of joint 1 holds nothing of joint 2.
    assert [("line", (0,)), ("plane", (1,))] in told
    assert [("line", (0,))] not in told
