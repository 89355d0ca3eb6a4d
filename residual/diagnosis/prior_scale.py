"""Choose the set of effects, the scale of the rigid prior and that of given values.

They are chosen together, after the search: a scale chosen before it widens until the
parameters swallow the effect. So with the values that a model is given, kind by kind:
of twenty that are right the twenty-first stands out, of twenty rough ones none does.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from residual.diagnosis.candidates import Candidates
from residual.diagnosis.search import search
from residual.diagnosis.task import Rules, Task
from residual.evidence.design import Design
from residual.evidence.fit import Fit, Prior, fit
from residual.evidence.priors import (
    WIDTHS,
    forbidden,
    priors,
    relative_prior,
    scales_of,
)
from residual.model.nominal import Nominal
from residual.recording import Array

DOUBT = 6.0  # nats within which two scales cannot be told apart
LEAST_WIDE = 0.1
PER_NAME = 2.0  # nats a name costs when scales are compared
ROUNDS = 3  # looks at the widths of single kinds

Widths = Mapping[str, float]


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


@dataclass(frozen=True, eq=False, slots=True)
class _Runs:
    """Searches made so far, by the prior's scale and widths."""

    design: Design
    nominal: Nominal
    candidates: Candidates
    rules: Rules
    done: dict[tuple, Selection] = field(default_factory=dict)

    def search(self, prior: Prior) -> None:
        """Search under a prior, unless that was done."""
        if (key := _key(prior)) not in self.done:
            allowed = self.candidates.without(tuple(forbidden(prior, self.nominal)))
            task = Task(self.design, prior, allowed, self.rules)
            self.done[key] = Selection(task, search(task), prior)

    def prior(self, scale: float, widths: Widths) -> Prior:
        """A prior by its scale and widths."""
        return relative_prior(self.design, self.nominal, scale, widths)

    @property
    def counted(self) -> Array:
        """Rows of each joint, counted alike for all runs. Shape (dof,)."""
        return np.max([r.fit.counted for r in self.done.values()], axis=0)

    @property
    def winner(self) -> Selection:
        """The run with the most evidence."""
        counted = self.counted
        return max(self.done.values(), key=lambda r: _worth(r, counted))


def _key(prior: Prior) -> tuple:
    return prior.scale, tuple(sorted((prior.widths or {}).items()))


def select(
    design: Design,
    nominal: Nominal,
    candidates: Candidates,
    rules: Rules,
    progress: Callable[[float], None] = lambda fraction: None,
) -> Selection:
    """Search under the priors and keep the pair with the most evidence.

    Every scale of the rigid part is tried with the values as they were said to be; at
    the best, every width for all of them; then each kind of value may go its own way;
    then that scale's neighbours.

    Args:
        design: Columns and Gram.
        nominal: The nominal model.
        candidates: All that may be named under some prior.
        rules: Thresholds.
        progress: Told the share done.
    """
    runs = _Runs(design, nominal, candidates, rules)
    every = priors(design, nominal)
    for turn, wanted in enumerate((_as_said, _at_its_scale, _by_kind, _beside_it)):
        for prior in wanted(runs, every):
            runs.search(prior)
            progress((turn + len(runs.done) / (len(runs.done) + 2)) / 4)
    winner = runs.winner
    wide = _widest(runs, winner)
    return replace(winner, fit=winner.task.settle(winner.fit), wide=wide)


def _as_said(runs: _Runs, every: Sequence[Prior]) -> list[Prior]:
    return [p for p in every if p.widths == every[0].widths]


def _at_its_scale(runs: _Runs, every: Sequence[Prior]) -> list[Prior]:
    scale = runs.winner.wide.scale
    return [p for p in every if p.scale == scale]


def _by_kind(runs: _Runs, every: Sequence[Prior]):
    """Widths of single kinds, by the evidence with the winner's names held."""
    for _ in range(ROUNDS if runs.nominal.widths is None else 0):
        best = runs.winner
        if len(best.wide.widths or {}) < 2:
            return
        turned = _turned(runs, best)
        if _key(turned) in runs.done:
            return
        yield turned


def _turned(runs: _Runs, best: Selection) -> Prior:
    """The prior with each kind's width at its best, one after the other."""
    prior, counted = best.wide, runs.counted
    for kind in best.wide.widths:
        trials = [
            prior
            if width == prior.widths[kind]
            else runs.prior(prior.scale, {**prior.widths, kind: width})
            for width in WIDTHS
        ]
        prior = max(
            trials,
            key=lambda p: (
                fit(runs.design, p, best.fit.members, counted, rounds=4).score
            ),
        )
    return prior


def _beside_it(runs: _Runs, every: Sequence[Prior]) -> list[Prior]:
    best, scales = runs.winner.wide, scales_of(runs.nominal)
    if best.widths is None:
        return []
    at = scales.index(best.scale)
    return [runs.prior(s, best.widths) for s in scales[max(at - 1, 0) : at + 2]]


def _widest(runs: _Runs, run: Selection) -> Prior:
    """The widest prior within 6 nats, and none under 10 % where the scale is open.

    How wrong a URDF is can be estimated only as far as the wrong values can be seen;
    what trades off against a load cannot. Given values are held as they were when the
    effects were named: one that may be off at will leaves nothing to be named.
    """
    prior, scales = run.task.prior, scales_of(runs.nominal)
    if prior.widths is None or len(scales) == 1:
        return prior
    alike = [runs.prior(s, prior.widths) for s in scales]
    members, counted = run.fit.members, runs.counted
    scores = [fit(runs.design, p, members, counted, rounds=4).score for p in alike]
    near = [
        p
        for p, score in zip(alike, scores, strict=True)
        if score > max(scores) - DOUBT or p.scale == LEAST_WIDE
    ]
    return max(near, key=lambda p: p.scale)


def neighbours(design: Design, nominal: Nominal, prior: Prior) -> tuple[Prior, ...]:
    """Priors that a search might have turned to, beside the one that it chose.

    Args:
        design: Columns.
        nominal: The nominal model.
        prior: The chosen one.
    """
    if prior.widths is None:
        return ()
    out = list(priors(design, nominal))
    out += [
        relative_prior(design, nominal, s, prior.widths) for s in scales_of(nominal)
    ]
    if len(prior.widths) > 1 and nominal.widths is None:
        out += [
            relative_prior(design, nominal, prior.scale, {**prior.widths, kind: width})
            for kind in prior.widths
            for width in WIDTHS
        ]
    unique = {_key(p): p for p in out}
    unique.pop(_key(prior), None)
    return tuple(unique.values())


def _worth(run: Selection, counted) -> float:
    """Evidence of a run with rows counted alike for all, less the price of names."""
    task, members = run.task, run.fit.members
    common = fit(task.design, task.prior, members, counted, rounds=4)
    return common.score - sum(task.candidates.cost(g) + PER_NAME for g in members)
