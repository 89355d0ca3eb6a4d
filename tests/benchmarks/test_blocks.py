"""One criterion by blocks, against regressions written out and planted truth."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.blocks.names import name_probability
from benchmarks.blocks.score import Score
from benchmarks.blocks.search import Search
from residual.diagnosis.search import Candidates
from residual.evidence.fit import fit_jointly
from residual.evidence.thresholds import THRESHOLDS
from tests.residual.linear import DOF, LINE, Problem, build, every_group


def draw(seed, truth=(), **options):
    problem = Problem.draw(np.random.default_rng(seed), truth, logs=12, **options)
    groups = every_group(problem.design)
    price = {g.key: float(np.log(len(groups))) for g in groups}
    search = Search(
        Score(problem.design, problem.prior), Candidates(tuple(groups), price), ()
    )
    return problem, groups, search


def test_left_out_errors_are_those_of_a_refit_without_the_block():
    problem, groups, search = draw(1, [(LINE, (0,), [2.0])], masked=0.2)
    members = (groups[0],)
    fitted = search.score.fit(members)
    left = search.score.left_out(fitted)
    weight = fitted.weight(problem.design.rows)
    for block in range(len(problem.logs)):
        others = [k for k in range(len(problem.logs)) if k != block]
        x, y, joint = problem.stacked(members, others)
        w = weight[joint][:, None]
        theta = np.linalg.solve(
            x.T @ (w * x) + problem.precision(members), x.T @ (w[:, 0] * y)
        )
        x, y, joint = problem.stacked(members, [block])
        errors = np.bincount(joint, (y - x @ theta) ** 2, minlength=DOF)
        np.testing.assert_allclose(left.errors[block], errors, rtol=1e-8)


def test_evidence_does_not_depend_on_the_order_of_the_logs():
    truth = [(LINE, (0,), [0.3])]
    _, groups, search = draw(2, truth)
    nats = search.score.nats(search.score.fit(groups[:1]), groups[0])
    problem, *_ = draw(2, truth)
    problem.logs.reverse()
    problem.design = build(problem.logs)
    groups = every_group(problem.design)
    score = Score(problem.design, problem.prior)
    fitted = score.fit(groups[:1])
    # Only single blocks: which of them are joined is a matter of their order.
    last = score.nats(fitted, groups[0], score.covariances(fitted)[:1])
    assert last == pytest.approx(nats, rel=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_a_planted_effect_is_found_and_nothing_else(seed):
    *_, search = draw(seed, [(LINE, (1,), [1.0])])
    found = search.run()
    assert [(g.effect.name, g.joints) for g in found.named] == [("line", (1,))]


@pytest.mark.parametrize("seed", range(3))
def test_nothing_is_found_where_nothing_is_missing(seed):
    *_, search = draw(seed)
    assert search.run().named == ()


def test_more_evidence_is_a_higher_probability():
    nats = np.geomspace(1, 100, 20)
    assert np.all(np.diff([name_probability(x) for x in nats]) > 0)
    assert name_probability(12.0) == pytest.approx(0.5)


@pytest.mark.parametrize("deviations", [90.0, 100.0, 130.0])
def test_the_better_of_two_fixed_points_is_taken(deviations):
    """What the prior of a wrong coefficient holds back is noise, or it gives way."""
    problem = Problem.draw(np.random.default_rng(0), rows=200, noise=0.05)
    wrong = deviations / np.sqrt(problem.prior.precision[10, 10])
    logs = [
        (replace(own, tau=own.tau + wrong * state.regressor[:, :, 10]), state)
        for own, state in problem.logs
    ]
    design, prior = build(logs), problem.prior
    fitted = Score(design, prior).fit(())
    floor = (THRESHOLDS.noise_floor * design.rms) ** 2
    others = [
        fit_jointly(design, prior, (), fitted.counted, start, 40)
        for start in (None, floor)
    ]
    assert fitted.score > max(other.score for other in others) - 0.1
