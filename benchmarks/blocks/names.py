"""Names and their probability: searches under every scale of what is given, averaged.

Of the scales that predict left-out blocks as well as the best (paired by block, t < 2)
each counts by its evidence. The probability of a name is the share of them in which it
stands, or what blocks cannot tell from it, times what evidence of its size is worth.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.blocks.rules import RULES
from benchmarks.blocks.score import LeftOut, Score, label_blocks
from benchmarks.blocks.search import (
    Found,
    Search,
    add_curves,
    is_curve,
    refine_last_shape,
)
from residual.diagnosis.constants import add_joint_constants
from residual.diagnosis.search import (
    Candidates,
    build_candidates,
    member_torque_shares,
    recompute_candidates,
)
from residual.effects.base import EffectTrait
from residual.evidence.columns import CandidateColumns
from residual.evidence.design import Design
from residual.evidence.fit import (
    Fit,
    NominalPrior,
    build_fitted_model,
    fit_jointly,
    fit_nominal,
    keep_physical_terms,
)
from residual.evidence.priors import WIDTHS, PriorSpace, build_relative_prior
from residual.evidence.thresholds import THRESHOLDS
from residual.model.nominal import (
    FitLogs,
    NominalModel,
    choose_declared_effects,
    prepare_fit_logs,
)
from residual.recording import Recording
from residual.robot.robot import Robot
from residual.signals.splitting import find_session_start
from residual.signals.track import FilterSettings


@dataclass(frozen=True, eq=False, slots=True)
class Name:
    """One named effect on one joint, or of the whole arm."""

    group: CandidateColumns  # the effect, joints and shape
    nats: float  # evidence that it carries in the whole set
    share: float  # largest rms torque on a joint, as a share of the joint's rms
    probability: float  # of its class against all other names and none
    equivalent: tuple[CandidateColumns, ...]  # what blocks cannot tell from it


def names(robot: Robot, fit: Sequence[Recording]) -> tuple[list[list], list[list]]:
    """Return names that are sure, and those that are likelier than not.

    Returns:
        Each as effect, joint (from 1; 0 for the whole arm), equivalents, probability;
        most torque first.
    """
    clock = find_session_start(fit)
    logs = prepare_fit_logs(robot, fit, clock, FilterSettings())
    nominal = add_joint_constants(logs, choose_declared_effects(robot, None))
    every = sorted(select_names(logs, nominal), key=lambda n: -n.share)
    rows = [
        [n.group.effect.name, j + 1, _effects(n.equivalent), n.probability]
        for n in every
        for j in n.group.joints or (-1,)
    ]
    sure = [row for row in rows if row[3] >= RULES.sure_probability]
    return sure, [x for x in rows if 0.5 <= x[3] < RULES.sure_probability]


def _effects(groups: Sequence[CandidateColumns]) -> list[str]:
    return [g.effect.name for g in groups]


def select_names(logs: FitLogs, nominal: NominalModel) -> list[Name]:
    """Search the logs for what the nominal model lacks."""
    design = Design(logs.tracks, nominal.model, labels=label_blocks(logs.tracks))
    first = build_relative_prior(design, nominal, THRESHOLDS.first_scale)
    design.set_torque_model(build_fitted_model(nominal, fit_nominal(design, first)))
    candidates = build_candidates(design, nominal, logs.span, logs.clock is not None)
    curves = add_curves(design, logs.tracks)
    space = PriorSpace(design, nominal)

    def search(prior: NominalPrior) -> Search:
        allowed = candidates.without(tuple(space.list_barred_effects(prior)))
        return Search(Score(design, prior), allowed, curves)

    # Columns that read the model's torque see it with what a first search finds.
    found = search(first).run()
    if _reads_torque(found):
        _settle_torque_model(found, nominal)
        candidates = recompute_candidates(design, candidates)
    runs: dict[tuple, Found] = {}

    def run(prior: NominalPrior) -> Found:
        key = prior.scale, tuple(sorted(prior.widths.items()))
        if key not in runs:
            runs[key] = search(prior).run()
        return runs[key]

    # From free to exact: where values are worse than a scale says, so is its forecast.
    # Below the scales that are too rough for names of bodies such a name may mend it.
    for rough in (True, False):
        own: list[Found] = []
        for scale in reversed(space.scales):
            if (scale > THRESHOLDS.rough_scale) == rough:
                own.append(run(space.at(scale, space.even[0])))
                if _falls_behind(own):
                    break
    weighted = _weigh(design, candidates, list(runs.values()))
    if others := _other_widths(space, weighted):
        for prior in others:
            run(prior)
        weighted = _weigh(design, candidates, list(runs.values()))
    return _conclude(weighted, search, _Constants.of(design, nominal, curves))


def _reads_torque(found: Found) -> bool:
    """Whether something was found that shifts what reads the model's torque."""
    design = found.score.design
    shares = [
        float(member_torque_shares(design, found.fit, g).max()) for g in found.named
    ]
    uses = [EffectTrait.USES_MODEL in g.effect.traits for g in found.named]
    return any(uses) or max(shares, default=0.0) > THRESHOLDS.large_torque_share


def _settle_torque_model(found: Found, nominal: NominalModel) -> None:
    """Let the design see the torque of the named effects, iterated: Gauss-Newton."""
    design, fitted, score = found.score.design, found.fit, found.score
    for _ in range(THRESHOLDS.refit_rounds):
        model = build_fitted_model(nominal, _without_curves(score, fitted))
        design.set_torque_model(keep_physical_terms(model))
        members = tuple(design.add([g.placed for g in fitted.members]))
        for group in members:
            if group.effect.refine and EffectTrait.USES_MODEL in group.effect.traits:
                others = tuple(g for g in members if g is not group)
                members = refine_last_shape(score, (*others, group), fitted)
        before, fitted = fitted.score, score.fit(members, fitted)
        if abs(fitted.score - before) < THRESHOLDS.steady_nats:
            break


def _without_curves(score: Score, fitted: Fit) -> Fit:
    return score.fit([g for g in fitted.members if not is_curve(g)], fitted)


@dataclass(frozen=True, eq=False, slots=True)
class Weighted:
    """Searches that predict left-out blocks as well as the best, likeliest first."""

    runs: tuple[Found, ...]
    share: tuple[float, ...]  # of the evidence

    @property
    def best(self) -> Found:
        """The run with the most evidence."""
        return self.runs[0]


def _weigh(design: Design, candidates: Candidates, runs: Sequence[Found]) -> Weighted:
    """Weigh runs by evidence, each name priced."""
    power = np.maximum(design.power.sum(axis=0), 1e-30)
    first = min(runs, key=lambda r: float((r.left_out.errors / power).sum()))
    lefts = [replace(r.left_out, weight=first.left_out.weight) for r in runs]
    best = min(lefts, key=lambda x: float((x.errors @ x.weight).sum()))
    same = [r for r, x in zip(runs, lefts, strict=True) if _predicts_as_well(x, best)]
    counted = np.max([r.fit.counted for r in runs], axis=0)
    least = float(np.log(1 / RULES.false_chance))

    def evidence(run: Found) -> float:
        prior, start = run.score.prior, run.fit.variance
        members = run.fit.members
        common = fit_jointly(design, prior, members, counted, start, rounds=4)
        price = float(np.log(len(candidates.price)))
        costs = (price if is_curve(g) else candidates.cost(g) for g in members)
        return common.score - sum(cost + least for cost in costs)

    values = np.array([evidence(r) for r in same])
    order = np.argsort(-values)
    share = np.exp(values[order] - values.max())
    share /= share.sum()
    return Weighted(tuple(same[i] for i in order), tuple(share.tolist()))


def _predicts_as_well(left: LeftOut, best: LeftOut) -> bool:
    loss = best.gain_over(left)
    scatter = loss.std(ddof=1) * np.sqrt(len(loss))
    if loss.sum() <= RULES.same_deviations * scatter:
        return True
    total, least = (float((x.errors @ x.weight).sum()) for x in (left, best))
    return total < (1 + RULES.same_share) * least


def _falls_behind(runs: Sequence[Found]) -> bool:
    """Whether the last run predicts left-out blocks clearly worse than the best."""
    weight = runs[-1].left_out.weight
    lefts = [replace(r.left_out, weight=weight) for r in runs]
    best = min(lefts, key=lambda x: float((x.errors @ weight).sum()))
    total, least = (float((x.errors @ weight).sum()) for x in (lefts[-1], best))
    behind = total > (1 + RULES.hopeless_share) * least
    return behind and not _predicts_as_well(lefts[-1], best)


def _other_widths(space: PriorSpace, weighted: Weighted) -> list[NominalPrior]:
    """Priors with other widths of given values beside the best, one kind at a time."""
    if not space.free or not weighted.best.score.prior.widths:
        return []
    prior = weighted.best.score.prior
    out = [space.at(prior.scale, widths) for widths in space.even]
    kinds = prior.widths if len(prior.widths) > 1 else ()
    trials = [
        space.at(prior.scale, {**prior.widths, kind: width})
        for kind in kinds
        for width in WIDTHS
    ]
    fitted, members = weighted.best.fit, weighted.best.fit.members

    def score(one: NominalPrior) -> float:
        return fit_jointly(
            space.design, one, members, fitted.counted, fitted.variance, rounds=4
        ).score

    return out + sorted(trials, key=score, reverse=True)[: THRESHOLDS.width_rounds]


@dataclass(frozen=True, eq=False, slots=True)
class _Constants:
    """The same logs with the constants of joints as candidates, not in the model."""

    space: PriorSpace
    groups: tuple[CandidateColumns, ...]
    curves: Sequence[CandidateColumns]

    @classmethod
    def of(
        cls,
        design: Design,
        nominal: NominalModel,
        curves: Sequence[CandidateColumns],
    ) -> "_Constants":
        """Take the constants out of the model; no column is computed anew."""
        count = nominal.constants
        if not count:
            return cls(PriorSpace(design, nominal), (), curves)
        terms, ids = nominal.model.terms[-count:], design.nominal[-count:]
        bare = design.drop_last_terms(count)
        groups = [
            bare.group_columns(t, ids[[i]])
            for i, t in enumerate(terms)
            if design.rows[t.joints[0]] >= THRESHOLDS.min_rows
        ]
        space = PriorSpace(bare, nominal.without_constants())
        return cls(space, tuple(groups), curves)

    def score(self, prior: NominalPrior) -> Score:
        """The same prior without constants."""
        return Score(self.space.design, self.space.at(prior.scale, prior.widths))

    def search(self, search: Search) -> Search:
        """The same search with constants among the candidates."""
        candidates = search.candidates
        if self.groups:
            candidates = candidates.beside(self.groups)
        return Search(self.score(search.score.prior), candidates, self.curves)


def _conclude(
    weighted: Weighted,
    search: Callable[[NominalPrior], Search],
    constants: _Constants,
) -> list[Name]:
    """The likeliest set with the probability of each name."""
    look = constants.search(search(weighted.best.score.prior))
    found = weighted.best.fit.members
    named = _drop_curved_constants(look.score, found, constants.groups)
    best = look.settle((*found, *named))
    return [_judge(look, best, weighted, g) for g in best.named]


def _drop_curved_constants(
    score: Score, found: Sequence[CandidateColumns], groups: Sequence[CandidateColumns]
) -> list[CandidateColumns]:
    """Constants but those of joints that follow a curve, of which they say little.

    A constant must explain most of what it and the curve explain together.
    """
    out = []
    for group in groups:
        curves = [g for g in found if is_curve(g) and g.joints == group.joints]
        if curves:
            others = [g for g in found if g not in curves]
            sets = (others, [*others, group], [*others, group, *curves])
            lefts = [score.left_out(score.fit(members)) for members in sets]
            none, alone, both = (x.errors[:, group.joints[0]].sum() for x in lefts)
            if none - alone < RULES.constant_share * (none - both):
                continue
        out.append(group)
    return out


def _judge(
    look: Search, best: Found, weighted: Weighted, group: CandidateColumns
) -> Name:
    """Evidence, equivalents and probability of one name."""
    score, fitted, left = best.score, best.fit, best.left_out
    rest = tuple(g for g in fitted.members if g is not group)
    without = score.fit(rest, fitted)
    bare = replace(score.left_out(without), weight=left.weight)
    removed = float(left.gain_over(bare).sum())
    within = max(THRESHOLDS.class_nats, RULES.class_share * removed)
    near, nats = [], score.nats(fitted, group)
    for trial in look.look(without, group, RULES.class_looks):
        if is_curve(trial.group) or trial.nats < nats / 2:
            continue
        if left.gain_over(replace(trial.left_out, weight=left.weight)).sum() < within:
            near.append(trial.group)
    alike = {group.effect.name, *(g.effect.name for g in near)}
    # A constant is free in every run.
    constant = EffectTrait.CONSTANT in group.effect.traits
    stands = constant or sum(
        share
        for run, share in zip(weighted.runs, weighted.share, strict=True)
        if any(_same_place(g, group) and g.effect.name in alike for g in run.named)
    )
    share = float(member_torque_shares(score.design, fitted, group).max())
    return Name(group, nats, share, float(stands) * name_probability(nats), tuple(near))


def _same_place(first: CandidateColumns, second: CandidateColumns) -> bool:
    whole = not first.joints or not second.joints
    return whole or first.joints == second.joints


def name_probability(nats: float) -> float:
    """Probability of a name by its evidence alone: logistic in ln(nats)."""
    odds = RULES.odds_slope * np.log(max(nats, 1e-3) / RULES.even_nats)
    return float(1 / (1 + np.exp(-odds)))
