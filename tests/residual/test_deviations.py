"""How sure a parameter is: by noise, by logs that disagree, by other textbook forms."""

from dataclasses import replace

import numpy as np

from residual.diagnosis.findings import estimate_uncertainties
from residual.effects.base import Effect, EffectTrait
from residual.effects.base import build_joint_columns as joint_columns
from tests.residual.linear import LINE, Problem, build
from tests.residual.test_search import seen

DRAWS = 20
READS = Effect(
    "reads", "reads the model", {"a": "1"}, joint_columns(lambda s, j, x: [s.tau_model[:, j]])
)
READS = replace(READS, traits=EffectTrait.USES_MODEL | EffectTrait.GROUPABLE)


def deviation(problem, shape):
    """Coefficient and deviation of the first parameter of one effect on joint 1."""
    effect, form = shape
    (group,) = problem.design.add([(effect, (0,), form)])
    fitted = problem.score.fit([group])
    theta = fitted.of(group)
    exact = {group: (theta, np.zeros((len(theta), len(theta))))}
    (sd,) = estimate_uncertainties(seen(problem.score), fitted, exact).values()
    return theta[0], sd.std, np.sqrt(np.diag(fitted.covariance())[fitted.slots(group)])


def disagreeing(seed, scatter):
    """An effect whose size differs from log to log, about 2."""
    rng = np.random.default_rng(seed)
    problem = Problem.draw(rng, noise=0.1, logs=6)
    sizes = 2.0 + scatter * rng.normal(size=6)
    logs = []
    for (own, state), size in zip(problem.logs, sizes, strict=True):
        tau = own.tau.copy()
        tau[:, 0] += size * state.q[:, 0]
        logs.append((replace(own, tau=tau), state))
    return Problem(logs, build(logs), problem.prior)


def test_logs_that_disagree_make_a_parameter_less_sure():
    """Two deviations hold the common size in nine of ten draws; noise's own do not."""
    inside, by_noise = [], []
    for seed in range(DRAWS):
        value, sd, own = deviation(disagreeing(seed, 0.3), (LINE, ()))
        inside.append(abs(value - 2.0) < 2 * sd[0])
        by_noise.append(abs(value - 2.0) < 2 * own[0])
    assert np.mean(inside) >= 0.85
    assert np.mean(by_noise) < 0.6
