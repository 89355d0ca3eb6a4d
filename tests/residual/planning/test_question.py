"""What a diagnosis leaves open, and what motions say to that, against densities."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from benchmarks.loop_parts.next import logged_products
from residual.planning.next_experiment import (
    NOTHING,
    TRAVEL,
    MotionInformation,
    OpenQuestion,
    Rival,
    RivalContest,
    RivalUpdate,
    SignalSettings,
    expect_separation,
    find_inseparable_pairs,
    mark_inseparable_alternatives,
    predict_best_motion,
    simulate_decision,
)
from residual.planning.next_experiment import expected_log_bayes_factor as log_bayes_factor
from residual.planning.next_experiment import rival_log_evidence as log_evidence
from residual.verdict.result import Alternative, Place
from tests.residual.planning.questions import SECONDS, logs, robot_and_question

RATE = 50.0  # Hz


def shrunk_to(question, size):
    (contest,) = question.contests
    rivals = []
    for one in contest.rivals:
        mean = one.mean.copy()
        mean[np.isin(one.columns, one.effect_columns)] *= size
        rivals.append(replace(one, mean=mean))
    return replace(question, contests=(replace(contest, rivals=tuple(rivals)),))


def test_a_spring_of_some_size_is_no_twin_of_a_balancer_and_a_tiny_one_is():
    _, question = robot_and_question("spring", 2)
    assert find_inseparable_pairs(question) == set()
    assert predict_best_motion(question) is not None
    tiny = shrunk_to(question, 0.01)
    assert find_inseparable_pairs(tiny) == {(0, 0, 1), (0, 1, 0)}
    assert predict_best_motion(tiny) is None


def test_a_set_that_no_motion_tells_from_the_named_one_is_marked():
    _, question = robot_and_question("spring", 2)
    named = [Place("spring", (3,)), Place("offset", (1,))]
    sets = ((Place("offset", (1,)), Place("balancer", (3,))), (Place("offset", (1,)),))
    others = [Alternative(one, -1.0, "motion") for one in sets]

    def by(robot_and_question):
        return [
            a.separated_by for a in mark_inseparable_alternatives(robot_and_question, named, others)
        ]

    assert by(question) == ["motion", "motion"]
    assert by(shrunk_to(question, 0.01)) == ["nothing", "motion"]


def test_a_planned_motion_is_seen_as_its_log_will_be():
    """Nothing is filtered where a motion is planned; its log is, and has noise."""
    _, question = robot_and_question("spring", 2)
    _, (log, _) = logs("spring", 2)
    ((seen, _),) = logged_products(question, log, [SECONDS])
    q = np.column_stack([np.convolve(c, np.ones(9) / 9, "same") for c in log.q.T])
    qd = np.gradient(q, 1 / 250, axis=0)
    every = [x[10:-10:5] for x in (q, qd, np.gradient(qd, 1 / 250, axis=0))]
    planned = MotionInformation.of(question, every, RATE).gram(SECONDS)
    own = question.contests[0].rivals[0].effect_columns
    ratio = np.diag(planned)[own] / np.diag(seen)[own]
    # Rows within 0.1 s of a turn are a matter of a sample more or less.
    np.testing.assert_allclose(ratio, 1.0, atol=0.15)


# Expected and realised evidence from Gram matrices, against densities written out.


COLUMNS, ROWS = 6, 12


def rival(rng, columns, own, name="a"):
    k = len(columns)
    root = rng.normal(size=(k, k + 2))
    return Rival(
        place=Place(name, (1,)) if len(own) else NOTHING,
        columns=np.array(columns),
        effect_columns=np.array(own, dtype=int),
        mean=rng.normal(size=k),
        precision=root @ root.T,
        nats=0.0,
    )


def density(x, one):
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
    signals = SignalSettings(np.ones(1), np.ones(1), 10.0, 0.1, 0.5, 0.0)
    return OpenQuestion(None, None, (), signals, contests)


def contest(*rivals, enough=6.0):
    return RivalContest(tuple(rivals), enough)


def course(x, edge=0.0):
    """One joint, of which the rows of a motion come one by one, ten a second."""
    return MotionInformation(x[:, None, :], 10.0, 0.0, edge)


def test_the_evidence_of_one_log_is_the_ratio_of_two_densities(case):
    rng, x, a, b = case
    y = rng.normal(size=ROWS)
    gram, products = x.T @ x, (x.T @ y)[:, None]
    ours = [log_evidence(products, gram, RivalUpdate.of(r, gram))[0] for r in (a, b)]
    theirs = [density(x, r).logpdf(y) for r in (a, b)]
    assert ours[0] - ours[1] == pytest.approx(theirs[0] - theirs[1], abs=1e-9)


def test_what_is_expected_is_the_mean_of_what_logs_of_the_found_size_bring(case):
    rng, x, a, b = case
    one, other = density(x, a), density(x, b)
    y = x[:, a.columns] @ a.mean + rng.normal(size=(40_000, ROWS))
    brought = one.logpdf(y) - other.logpdf(y)
    gram = x.T @ x
    value = log_bayes_factor(gram, RivalUpdate.of(a, gram), RivalUpdate.of(b, gram))
    assert value == pytest.approx(brought.mean(), abs=4 * brought.std() / 200)
    assert value > 1  # else anything would do


def test_a_longer_motion_of_what_is_known_well_never_promises_less(case):
    _, x, a, b = case
    a = replace(a, precision=1e3 * a.precision)  # else B may say the same more surely
    promised = []
    for times in (0.0, 0.1, 1.0, 3.0, 10.0, 100.0):
        gram = times * x.T @ x
        promised.append(log_bayes_factor(gram, RivalUpdate.of(a, gram), RivalUpdate.of(b, gram)))
    assert promised[0] == pytest.approx(0, abs=1e-9)
    assert np.all(np.diff(promised) > 0)


def twins_of(asked, *parts):
    return find_inseparable_pairs(asked, [course(x) for x in parts])


def test_the_same_columns_on_every_motion_are_twins_and_a_part_of_them_is_a_case():
    rng = np.random.default_rng(3)
    x = rng.normal(size=(round(10 * TRAVEL), COLUMNS))
    x[:, 3] = -2 * x[:, 2]  # one column twice
    a, b = rival(rng, [0, 2], [2]), rival(rng, [0, 3], [3], "b")
    open_question = question(contest(a, b, rival(rng, [0, 3, 4], [3, 4], "wide")))
    twins = twins_of(open_question, x)
    assert twins == {(0, 0, 1), (0, 1, 0), (0, 0, 2), (0, 1, 2)}
    seen = expect_separation(open_question, x.T @ x, twins)
    assert set(seen.nats) == {(0, 2, 0), (0, 2, 1)}
    assert min(seen.nats.values()) > 0


@pytest.mark.parametrize("size", [0.01, 0.1, 1.0, 3.0])
def test_twins_are_a_matter_of_nats_at_the_found_size(size):
    """Columns that share 99.9 % of their power are apart where they are large."""
    rng = np.random.default_rng(4)
    x = rng.normal(size=(round(10 * TRAVEL), COLUMNS))
    x[:, 3] = x[:, 2] + 0.03 * x[:, 3]
    a, b = rival(rng, [0, 2], [2]), rival(rng, [0, 3], [3], "b")
    a, b = (replace(r, mean=np.array([0.0, 10 * size])) for r in (a, b))
    open_question = question(contest(a, b))
    one, other = x[:, 2], x[:, 3]
    apart = one - other * (one @ other) / (other @ other)
    nats = 0.5 * (10 * size) ** 2 * (apart @ apart)
    assert ((0, 0, 1) in twins_of(open_question, x)) == (nats < 6.0)
    assert (nats < 1) == (size < 0.5)  # both sides are looked at


def test_the_chance_is_the_share_of_logs_that_settle_it(case):
    rng, x, a, b = case
    open_question = question(contest(a, b, enough=3.0))
    gram = x.T @ x
    settled, leads = [], []
    for true, other in ((a, b), (b, a)):
        y = density(x, true).rvs(20_000, random_state=rng)
        lead = density(x, true).logpdf(y) - density(x, other).logpdf(y)
        settled.append((lead >= 3).mean())
        leads.append(lead)
    sure = simulate_decision(open_question, gram, frozenset(), np.random.default_rng(1))
    assert sure.chance == pytest.approx(np.mean(settled), abs=0.07)  # of 400 draws each
    assert 0.05 < sure.chance < 0.95
    low, high = np.quantile(np.concatenate(leads), [0.43, 0.57])
    assert low < sure.nats < high


def test_a_motion_that_repeats_counts_like_the_whole_of_it(case):
    rng, *_ = case
    opening, period = rng.normal(size=(20, 1, 3)), rng.normal(size=(30, 1, 3))
    short = MotionInformation(np.concatenate([opening, period]), 10.0, 2.0, 0.5)
    long = MotionInformation(np.concatenate([opening, *[period] * 4]), 10.0, 0.0, 0.5)
    for seconds in (0.7, 3.0, 5.0, 5.6, 9.3, 13.9):
        np.testing.assert_allclose(short.gram(seconds), long.gram(seconds), atol=1e-9)
