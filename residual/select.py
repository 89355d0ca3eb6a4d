"""Choose the set of effects and the scale of the rigid prior together.

The scale is chosen after the search: chosen before it, the prior widens until the
inertial parameters swallow the effect.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.candidates import Candidates
from residual.design import Design
from residual.evidence import Fit, Prior, fit
from residual.search import Rules, Task, search

DOUBT = 6.0  # nats within which two scales cannot be told apart
LEAST_WIDE = 0.1
PER_NAME = 2.0  # nats a name costs when scales are compared


@dataclass(frozen=True, eq=False, slots=True)
class Selection:
    """The search's result.

    Attributes:
        task: Data under the chosen prior.
        fit: Its best fit.
        wide: The widest prior that the logs do not contradict, for standard deviations.
    """

    task: Task
    fit: Fit
    wide: Prior


def select(
    design: Design,
    choices: Sequence[tuple[Prior, Candidates]],
    rules: Rules,
    progress: Callable[[float], None] = lambda fraction: None,
) -> Selection:
    """Search under every prior and keep the pair with the most evidence.

    Args:
        design: Columns and Gram.
        choices: Priors, each with the candidates it allows.
        rules: Thresholds.
        progress: Told the share done.
    """
    runs = []
    for i, (prior, candidates) in enumerate(choices):
        task = Task(design, prior, candidates, rules)
        runs.append(Selection(task, search(task), prior))
        progress((i + 1) / len(choices))
    counted = np.max([r.fit.counted for r in runs], axis=0)
    winner = max(runs, key=lambda r: _worth(r, counted))
    wide = _widest([p for p, _ in choices], winner, counted)
    return replace(winner, fit=winner.task.settle(winner.fit), wide=wide)


def _widest(priors: Sequence[Prior], run: Selection, counted) -> Prior:
    """The widest prior within 6 nats, and none under 10 % where the scale is open.

    How wrong a URDF is can be estimated only as far as the wrong values can be seen;
    what trades off against a load cannot. Assumed values are held as they were when
    the effects were named: one that may be off at will leaves nothing to be named.
    """
    priors = [p for p in priors if p.assumed == run.task.prior.assumed]
    if len(priors) == 1:
        return priors[0]
    members, design = run.fit.members, run.task.design
    scores = [fit(design, p, members, counted, rounds=4).score for p in priors]
    near = [
        p
        for p, score in zip(priors, scores, strict=True)
        if score > max(scores) - DOUBT or p.scale == LEAST_WIDE
    ]
    return max(near, key=lambda p: p.scale)


def _worth(run: Selection, counted) -> float:
    """Evidence of a run with rows counted alike for all, less the price of names."""
    task, members = run.task, run.fit.members
    common = fit(task.design, task.prior, members, counted, rounds=4)
    return common.score - sum(task.candidates.cost(g) + PER_NAME for g in members)
