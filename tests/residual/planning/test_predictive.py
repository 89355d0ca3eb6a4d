"""Expected and realised evidence from Gram matrices, against densities written out."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from residual.diagnosis.result import Place
from residual.planning.outlook import (
    Refit,
    chance,
    drawn_products,
    expected_nats,
    gap,
    has_enough,
    log_evidence,
    outlook,
    structural_twins,
)
from residual.planning.question import NOTHING, Contest, Question, Rival, Signals

COLUMNS, ROWS = 6, 12


def rival(rng, columns, own, name="a"):
    """A rival with a random posterior."""
    k = len(columns)
    root = rng.normal(size=(k, k + 2))
    return Rival(
        place=Place(name, (1,)) if len(own) else NOTHING,
        columns=np.array(columns),
        own=np.array(own, dtype=int),
        mean=rng.normal(size=k),
        precision=root @ root.T,
        nats=0.0,
        explained=0.0,
    )


def density(x, one):
    """What a rival says of new rows."""
    x = x[:, one.columns]
    covariance = np.eye(len(x)) + x @ np.linalg.solve(one.precision, x.T)
    return multivariate_normal(x @ one.mean, covariance)


@pytest.fixture
def case():
    rng = np.random.default_rng(5)
    a = rival(rng, [0, 1, 2], [2])
    b = rival(rng, [0, 1, 3, 4], [3, 4], "b")
    return rng, 0.4 * rng.normal(size=(ROWS, COLUMNS)), a, b


def question(*contests):
    """A question of which only the contests are looked at."""
    signals = Signals(np.ones(1), np.ones(1), 10.0, 0.1, 0.5, 0.0)
    return Question(None, None, (), signals, contests)


def contest(*rivals, enough=6.0, kin=()):
    return Contest(tuple(rivals), enough, 0, frozenset(kin), rivals[-1])


def test_the_evidence_of_one_log_is_the_ratio_of_two_densities(case):
    rng, x, a, b = case
    y = rng.normal(size=ROWS)
    gram, products = x.T @ x, (x.T @ y)[:, None]
    ours = [log_evidence(products, gram, Refit.of(r, gram))[0] for r in (a, b)]
    theirs = [density(x, r).logpdf(y) for r in (a, b)]
    assert ours[0] - ours[1] == pytest.approx(theirs[0] - theirs[1], abs=1e-9)


def test_what_is_expected_is_the_mean_of_what_logs_bring(case):
    rng, x, a, b = case
    one, other = density(x, a), density(x, b)
    y = one.rvs(40_000, random_state=rng)
    brought = one.logpdf(y) - other.logpdf(y)
    gram = x.T @ x
    value = expected_nats(gram, Refit.of(a, gram), Refit.of(b, gram))
    assert value == pytest.approx(brought.mean(), abs=4 * brought.std() / 200)
    assert value > 1  # else anything would do


def test_logs_drawn_by_their_gram_bring_the_same(case):
    rng, x, a, b = case
    gram = x.T @ x
    first, other = Refit.of(a, gram), Refit.of(b, gram)
    products = drawn_products(gram, first, rng, 40_000)
    brought = log_evidence(products, gram, first) - log_evidence(products, gram, other)
    value = expected_nats(gram, first, other)
    assert brought.mean() == pytest.approx(value, abs=4 * brought.std() / 200)


def test_with_all_known_of_a_only_the_t_criterion_is_left(case):
    """0.5 d' (G_AA - G_AB (G_BB + L)^-1 G_BA) d, where A has nothing that is open."""
    rng, x, _, b = case
    gram, delta = x.T @ x, rng.normal(size=2)
    a = Rival(
        Place("a", (1,)),
        np.array([2, 5]),
        np.array([2, 5]),
        delta,
        1e12 * np.eye(2),
        0.0,
        0.0,
    )
    b = Rival(b.place, b.columns, b.own, np.zeros(4), b.precision, 0.0, 0.0)
    mixed = gram[np.ix_(b.columns, a.columns)]
    inner = np.linalg.inv(gram[np.ix_(b.columns, b.columns)] + b.precision)
    wanted = delta @ (gram[np.ix_(a.columns, a.columns)] - mixed.T @ inner @ mixed)
    assert gap(gram, a, Refit.of(b, gram)) == pytest.approx(wanted @ delta, rel=1e-9)


def test_twins_are_expected_to_bring_nothing(case):
    _, x, a, _ = case
    gram = x.T @ x
    twin = Rival(Place("t", (1,)), a.columns, a.own, a.mean, a.precision, 0.0, 0.0)
    refit = Refit.of(a, gram)
    assert expected_nats(gram, refit, Refit.of(twin, gram)) < 1e-9


def test_a_longer_motion_never_promises_less(case):
    _, x, a, b = case
    promised = []
    for times in (0.0, 0.1, 1.0, 3.0, 10.0, 100.0):
        gram = times * x.T @ x
        promised.append(expected_nats(gram, Refit.of(a, gram), Refit.of(b, gram)))
    assert promised[0] == pytest.approx(0, abs=1e-9)
    assert np.all(np.diff(promised) > 0)


def test_the_same_columns_on_every_motion_are_twins_and_a_part_of_them_is_a_case():
    rng = np.random.default_rng(3)
    x = rng.normal(size=(40, COLUMNS))
    x[:, 3] = -2 * x[:, 2]  # one column twice
    a, b = rival(rng, [0, 2], [2]), rival(rng, [0, 3], [3], "b")
    wide = rival(rng, [0, 3, 4], [3, 4], "wide")
    asked = question(contest(a, b, wide))
    found = structural_twins(asked, [x[:20].T @ x[:20], x[20:].T @ x[20:]])
    assert found == {(0, 0, 1), (0, 1, 0), (0, 0, 2), (0, 1, 2)}
    seen = outlook(asked, x.T @ x, found)
    assert set(seen.nats) == {(0, 2, 0), (0, 2, 1)}
    assert seen.least == min(seen.nats.values()) > 0


def test_where_no_pair_can_be_told_apart_a_motion_is_worth_nothing(case):
    _, x, a, b = case
    asked, gram = question(contest(a, b)), x.T @ x
    every = frozenset({(0, 0, 1), (0, 1, 0)})
    seen = outlook(asked, gram, every)
    assert (seen.least, seen.worth, dict(seen.nats)) == (0.0, 0.0, {})
    assert not has_enough(asked, 1e6 * gram, every)
    assert chance(asked, gram, every, np.random.default_rng(0)) == 0.0


def test_pairs_of_one_kind_count_only_as_far_as_they_come_apart(case):
    _, x, a, b = case
    gram, none = 1e4 * x.T @ x, rival(np.random.default_rng(9), [0, 1], [])
    free = Contest((a, b), 6.0, 0, frozenset(), none)
    kin = Contest((a, b), 6.0, 0, frozenset({(0, 1), (1, 0)}), none)
    loose, held = outlook(question(free), gram), outlook(question(kin), gram)
    assert held.least == loose.least == loose.worth
    assert held.worth < loose.worth
    assert held.worth == pytest.approx(6 * min(held.parted.values()))


def test_the_chance_is_the_share_of_logs_that_settle_it(case):
    rng, x, a, b = case
    asked = question(contest(a, b, enough=3.0))
    gram = x.T @ x
    settled = []
    for true, other in ((a, b), (b, a)):
        y = density(x, true).rvs(20_000, random_state=rng)
        lead = density(x, true).logpdf(y) - density(x, other).logpdf(y)
        settled.append((lead >= 3).mean())
    value = chance(asked, gram, frozenset(), np.random.default_rng(1))
    assert value == pytest.approx(np.mean(settled), abs=0.07)  # of 400 draws each
    assert 0.05 < value < 0.95
