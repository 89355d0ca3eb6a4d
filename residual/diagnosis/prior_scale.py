"""Choose the set of effects and the scale of the rigid prior together.

The scale is chosen after the search: chosen before it, the prior widens until the
inertial parameters swallow the effect.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.diagnosis.candidates import Candidates
from residual.diagnosis.search import search
from residual.diagnosis.task import Rules, Task
from residual.evidence.design import Design
from residual.evidence.fit import Fit, Prior, fit

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
    """Search under the priors and keep the pair with the most evidence.

    Every scale of the rigid part is tried under the loosest assumption, then every
    assumption at the best scale, then that scale's neighbours.

    Args:
        design: Columns and Gram.
        choices: Priors, each with the candidates it allows; by assumption, then scale.
        rules: Thresholds.
        progress: Told the share done.
    """
    priors, runs = [p for p, _ in choices], {}
    turns = (_loosest, _at_its_scale, _beside_it)
    for turn, wanted in enumerate(turns):
        for i in wanted(priors, _winner(runs)):
            if i not in runs:
                task = Task(design, *choices[i], rules)
                runs[i] = Selection(task, search(task), priors[i])
            progress((turn + (i + 1) / len(choices)) / len(turns))
    winner = _winner(runs)
    wide = _widest(priors, winner, _counted(runs))
    return replace(winner, fit=winner.task.settle(winner.fit), wide=wide)


def _loosest(priors: Sequence[Prior], best: Selection | None) -> list[int]:
    return [i for i, p in enumerate(priors) if p.assumed == priors[-1].assumed]


def _at_its_scale(priors: Sequence[Prior], best: Selection) -> list[int]:
    return [i for i, p in enumerate(priors) if p.scale == best.wide.scale]


def _beside_it(priors: Sequence[Prior], best: Selection) -> list[int]:
    alike = [i for i, p in enumerate(priors) if p.assumed == best.wide.assumed]
    at = next(k for k, i in enumerate(alike) if priors[i] is best.wide)
    return alike[max(at - 1, 0) : at + 2]


def _winner(runs: Mapping[int, Selection]) -> Selection | None:
    counted = _counted(runs)
    return max(runs.values(), key=lambda r: _worth(r, counted), default=None)


def _counted(runs: Mapping[int, Selection]):
    return np.max([r.fit.counted for r in runs.values()], axis=0) if runs else None


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
