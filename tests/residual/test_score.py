"""Laws of the evidence by blocks and of left-out blocks, against dense algebra."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from residual.diagnosis.score import label_blocks
from residual.diagnosis.select import name_probability
from residual.effects.base import Effect
from residual.evidence.fit import fit_jointly
from residual.evidence.thresholds import THRESHOLDS
from tests.residual.linear import BLOCK, DOF, GEAR, LINE, LOAD, NOMINAL, PLANE, Problem, build

# A column that the nominal model has too: a refit can imitate the effect exactly.
TWIN = Effect(
    "twin",
    "a nominal column",
    {"a": "1"},
    lambda s, joints, x: s.regressor[:, :, 10:11],
    scope="flange",
)
SETS = {"one joint": (PLANE, (0,)), "pair": (GEAR, (0, 1)), "all rows": (LOAD, (1,))}


def bent(rng, deviations, noise=1.0):
    """A nominal model whose one coefficient is wrong by many deviations."""
    drawn = Problem.draw(rng, rows=200, noise=noise)
    size = deviations / np.sqrt(drawn.prior.precision[10, 10])
    logs = [(replace(t, tau=t.tau + size * s.regressor[:, :, 10]), s) for t, s in drawn.logs]
    return Problem(logs, build(logs), drawn.prior)


def nats_of(problem, effect, joints):
    (group,) = problem.design.add([(effect, joints, ())])
    return problem.score.nats(problem.score.fit([group]), group)


@pytest.mark.parametrize("turn", [[[1e-4, 0.0], [0.0, 2e3]], [[1.0, -2.0], [0.5, 1.0]]])
def test_units_of_columns_and_their_order_do_not_matter(rng, turn):
    problem = Problem.draw(rng, [(PLANE, (0,), [0.3, 0.2])])
    turned = replace(PLANE, columns=lambda s, j, x: PLANE.columns(s, j, x) @ np.array(turn))
    one, other = (nats_of(problem, e, (0,)) for e in (PLANE, turned))
    assert one > 5
    assert other == pytest.approx(one, rel=1e-6)


def test_a_fit_does_not_depend_on_what_it_is_compared_with(rng):
    """Two joints ask for other parameters: neither wins by where the fit began."""
    drawn = Problem.draw(rng, rows=200, noise=0.1, slow=0.9, bend=0.0)
    ways = rng.normal(size=(DOF, NOMINAL)) / np.sqrt(np.diag(drawn.prior.precision))
    logs = [
        (replace(t, tau=t.tau + np.einsum("njp,jp->nj", s.regressor, ways)), s)
        for t, s in drawn.logs
    ]
    score = Problem(logs, build(logs), drawn.prior).score
    plain = score.fit(())
    few, all_rows = THRESHOLDS.min_rows, score.design.rows.max()
    for counted in ([few, all_rows], [all_rows, few]):
        other = score.fit((), replace(plain, counted=np.array(counted)))
        assert other.sse == pytest.approx(plain.sse, rel=0.05)


@pytest.mark.parametrize("order", [[3, 2, 1, 0], [1, 3, 0, 2]])
def test_the_order_of_logs_and_so_of_their_blocks_does_not_matter(rng, order):
    problem = Problem.draw(rng, [(LINE, (0,), [0.3])], masked=0.2, colour=0.5)
    logs = [problem.logs[i] for i in order]
    other = Problem(logs, build(logs), problem.prior)
    values = [nats_of(p, LINE, (0,)) for p in (problem, other)]
    assert values[0] == pytest.approx(values[1], rel=1e-6)


def test_blocks_that_disagree_bear_out_less_than_blocks_that_agree(rng):
    """The same torque on average, of another sign in every third block."""
    values = []
    for sizes in ([1.0, 1.0, 1.0], [3.0, 3.0, -3.0]):
        drawn = Problem.draw(np.random.default_rng(3), rows=360, noise=0.3)
        logs = []
        for own, state in drawn.logs:
            tau = own.tau.copy()
            size = np.resize(np.repeat(sizes, BLOCK), len(tau))
            tau[:, 0] += size * state.q[:, 0]
            logs.append((replace(own, tau=tau), state))
        values.append(nats_of(Problem(logs, build(logs), drawn.prior), LINE, (0,)))
    assert values[1] < values[0] / 2


@pytest.mark.parametrize("which", SETS)
def test_a_left_out_block_is_predicted_by_a_dense_fit_of_the_others(rng, which):
    effect, joints = SETS[which]
    problem = Problem.draw(rng, [(PLANE, (0,), [1.0, 1.0])], masked=0.2)
    members = problem.design.add([(effect, joints, ())])
    fitted = problem.score.fit(members)
    left = problem.score.left_out(fitted)
    even = np.exp(np.log(fitted.counted / problem.design.rows).mean())
    weight = even / fitted.variance
    np.testing.assert_allclose(left.weight, weight)
    x, y, joint = problem.stacked(members)
    block = np.concatenate(
        [
            (np.arange(len(t.tau)) // BLOCK + k * len(t.tau) // BLOCK)[t.moving[:, j]]
            for j in range(DOF)
            for k, (t, _) in enumerate(problem.logs)
        ]
    )
    for out in range(problem.design.folds):
        rest, own = block != out, block == out
        a = problem.precision(members)
        a = a + (x[rest].T * weight[joint[rest]]) @ x[rest]
        theta = np.linalg.solve(a, (x[rest].T * weight[joint[rest]]) @ y[rest])
        error = (y[own] - x[own] @ theta) ** 2
        expected = [error[joint[own] == j].sum() for j in range(DOF)]
        np.testing.assert_allclose(left.errors[out], expected, rtol=1e-8)


@pytest.mark.parametrize("deviations", [3.0, 30.0, 100.0, 300.0])
def test_of_two_fixed_points_of_noise_and_coefficients_the_likelier_is_taken(rng, deviations):
    """What the prior holds back is noise, or the prior gives way: both are stable."""
    problem = bent(rng, deviations, noise=0.05)
    design, prior, score = problem.design, problem.prior, problem.score
    fitted = score.fit(())
    floor = (THRESHOLDS.noise_floor * design.rms) ** 2
    starts = [fit_jointly(design, prior, (), fitted.counted, start, 40) for start in (None, floor)]
    assert fitted.score > max(f.score for f in starts) - 0.1


def test_a_name_is_likelier_the_more_speaks_for_it():
    values = [name_probability(nats) for nats in np.geomspace(0.1, 1000, 60)]
    assert all(less < more for less, more in pairwise(values))
    assert name_probability(-5.0) < 1e-3
    assert name_probability(THRESHOLDS.even_nats) == pytest.approx(0.5)
    sure = name_probability(THRESHOLDS.named_nats)
    assert sure == pytest.approx(THRESHOLDS.sure_probability)


@pytest.mark.parametrize("logs", [1, 3, 40])
def test_no_block_has_parts_of_two_logs_and_rows_ascend(rng, logs):
    problem = Problem.draw(rng, rows=1000, logs=logs)
    labels = label_blocks([t for t, _ in problem.logs])
    for one, other in pairwise(labels):
        assert other[0] == one[-1] + 1
    every = np.concatenate(labels)
    assert set(np.diff(every)) <= {0, 1}
    blocks = every[-1] + 1
    assert THRESHOLDS.min_blocks <= blocks <= THRESHOLDS.max_blocks
