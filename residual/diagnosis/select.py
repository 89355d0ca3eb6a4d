"""Choose the set of effects, the scale of the rigid prior and that of given values.

The inertial parameters have the prior N(given, (scale * size)^2), declared values
N(given, (width * value)^2); neither is known. Empirical Bayes takes the pair of prior
and set with the most evidence (type-II maximum likelihood; MacKay 1992),

    max over scale, widths, S of  ln p(y | S, scale, widths) - sum over S of prices.

Prior and set are chosen together, after a search under each prior: a scale that is
chosen first widens until the parameters absorb the effect. The grid is not searched in
full: all scales with the values as given, all widths at each local maximum, then the
width of each kind of value by itself, then the neighbors of the best scale.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from residual.diagnosis.search import Candidates, Task, search
from residual.evidence.fit import Fit, Prior, fit
from residual.evidence.priors import WIDTHS, PriorSpace
from residual.evidence.thresholds import THRESHOLDS, EvidenceThresholds
from residual.recording import Array

# Choose the set of effects, the scale of the rigid prior and that of given values.
#
# They are chosen together, after the search: a scale chosen before it widens until the
# parameters swallow the effect. So with the values that a model is given, kind by kind:
# of twenty that are right the twenty-first stands out, of twenty rough ones none does.


@dataclass(frozen=True, eq=False, slots=True)
class Selection:
    """The search's result."""

    task: Task  # data under the chosen prior
    fit: Fit  # its best fit
    # The widest prior that the logs do not contradict, for standard deviations.
    wide: Prior


@dataclass(frozen=True, eq=False, slots=True)
class _SearchRuns:
    """Searches so far by the prior's scale and widths, and what each may name."""

    space: PriorSpace
    candidates: Candidates
    rules: EvidenceThresholds
    done: dict[tuple, Selection] = field(default_factory=dict)
    allowed: dict[frozenset[str], Candidates] = field(default_factory=dict)

    def search(self, prior: Prior) -> None:
        """Search under a prior, unless that was done."""
        if (key := _key(prior)) not in self.done:
            barred = frozenset(self.space.barred(prior))
            if barred not in self.allowed:
                self.allowed[barred] = self.candidates.without(tuple(barred))
            task = Task(self.space.design, prior, self.allowed[barred], self.rules)
            self.done[key] = Selection(task, search(task), prior)

    @property
    def counted(self) -> Array:
        """Rows of each joint, counted alike for all runs. Shape (dof,)."""
        return np.max([r.fit.counted for r in self.done.values()], axis=0)

    @property
    def best(self) -> Selection:
        """The run with the most evidence."""
        counted = self.counted
        return max(self.done.values(), key=lambda r: _comparable_score(r, counted))

    def score(self, prior: Prior, run: Selection) -> float:
        """Evidence of a run's set under another prior [nats]."""
        members = run.fit.members
        return fit(self.space.design, prior, members, self.counted, rounds=4).score


def _key(prior: Prior) -> tuple:
    return prior.scale, tuple(sorted(prior.widths.items()))


def select(
    space: PriorSpace,
    candidates: Candidates,
    rules: EvidenceThresholds,
    progress: Callable[[float], None] = lambda fraction: None,
) -> Selection:
    """Search under the priors and keep the pair with the most evidence.

    Every scale of the rigid part is tried with the values as they were said to be; at
    each that is a hill, every width for all of them; then each kind of value may go
    its own way; then that scale's neighbours.

    Args:
        candidates: All that may be named under some prior.
    """

    def as_given(runs: _SearchRuns) -> Iterable[Prior]:
        return [space.at(scale, space.even[0]) for scale in space.scales]

    runs, turns = (
        _SearchRuns(space, candidates, rules),
        (as_given, _even_widths, _by_kind, _adjacent_scales),
    )
    for turn, wanted in enumerate(turns):
        for prior in wanted(runs):
            runs.search(prior)
            progress((turn + len(runs.done) / (len(runs.done) + 2)) / len(turns))
    best = runs.best
    return replace(best, fit=best.task.settle(best.fit), wide=_widest_prior(runs, best))


def _even_widths(runs: _SearchRuns) -> Iterable[Prior]:
    """Every width at the best scale, and at others that are best beside their own.

    A sharp prior with names and a wide one without are two hills of evidence.
    """
    scales, counted = runs.space.scales, runs.counted
    worth = [
        _comparable_score(run, counted) for run in runs.done.values()
    ]  # one a scale, so far
    walls = [-np.inf, *worth, -np.inf]
    tops = [
        scale
        for i, scale in enumerate(scales)
        if worth[i] >= max(walls[i], walls[i + 2])
        and worth[i] > max(worth) - THRESHOLDS.hill_nats
    ]
    return [runs.space.at(s, widths) for s in tops for widths in runs.space.even]


def _by_kind(runs: _SearchRuns) -> Iterable[Prior]:
    for _ in range(THRESHOLDS.width_rounds):
        best = runs.best
        if not runs.space.free or len(best.wide.widths) < 2:
            return
        turned = _best_widths(runs, best)
        if _key(turned) in runs.done:
            return
        yield turned


def _best_widths(runs: _SearchRuns, best: Selection) -> Prior:
    """The prior with the best width of each kind, one after the other."""
    prior = best.wide
    for kind in best.wide.widths:
        trials = [
            runs.space.at(prior.scale, {**prior.widths, kind: width})
            for width in WIDTHS
        ]
        prior = max([prior, *trials], key=lambda p: runs.score(p, best))
    return prior


def _adjacent_scales(runs: _SearchRuns) -> Iterable[Prior]:
    best, scales = runs.best.wide, runs.space.scales
    index = scales.index(best.scale)
    return [
        runs.space.at(s, best.widths) for s in scales[max(index - 1, 0) : index + 2]
    ]


def _widest_prior(runs: _SearchRuns, run: Selection) -> Prior:
    """The widest prior within 6 nats, and none under 10 % where the scale is open.

    How wrong a URDF is can be estimated only as far as the wrong values can be seen;
    what trades off against a load cannot. Given values are held as they were when the
    effects were named: one that may be off at will leaves nothing to be named.
    """
    prior, scales = run.task.prior, runs.space.scales
    if len(scales) == 1:
        return prior
    priors = [runs.space.at(s, prior.widths) for s in scales]
    scores = [runs.score(p, run) for p in priors]
    allowed = [
        p
        for p, score in zip(priors, scores, strict=True)
        if score > max(scores) - THRESHOLDS.alike_scale_nats
        or p.scale == THRESHOLDS.min_wide_scale
    ]
    return max(allowed, key=lambda p: p.scale)


def neighbor_priors(space: PriorSpace, prior: Prior) -> tuple[Prior, ...]:
    """Priors that a search might have turned to, beside the one that it chose."""
    pairs = [(s, widths) for widths in space.even for s in space.scales]
    pairs += [(s, prior.widths) for s in space.scales]
    if space.free and len(prior.widths) > 1:
        pairs += [
            (prior.scale, {**prior.widths, kind: width})
            for kind in prior.widths
            for width in WIDTHS
        ]
    priors = {_key(p): p for p in (space.at(*one) for one in pairs)}
    priors.pop(_key(prior), None)
    return tuple(priors.values())


def _comparable_score(run: Selection, counted: Array) -> float:
    """Evidence with equal row counts for all runs, less the price of names."""
    task, members = run.task, run.fit.members
    common = fit(task.design, task.prior, members, counted, rounds=4)
    # What a name costs beside its choice: a link's, all that a name must win.
    price = (
        THRESHOLDS.nats_per_link if g.effect.of_link else THRESHOLDS.nats_per_name
        for g in members
    )
    costs = (task.candidates.cost(g) for g in members)
    return common.score - sum(a + b for a, b in zip(costs, price, strict=True))
