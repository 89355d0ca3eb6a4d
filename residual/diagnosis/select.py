"""Names and their probability: an average of searches under every scale of the priors.

Scales that predict left-out blocks as well as the best (paired by block, t < 2) are
weighted by their evidence. The probability of a name is the weight of those with it, or
with an equivalent, times the reliability of evidence of its size.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.diagnosis.adequacy import assess_adequacy, torque_from_angle_noise
from residual.diagnosis.candidates import Candidates, build_candidates, recompute_candidates
from residual.diagnosis.score import LeftOut, Score, compute_scatter, is_alike, label_blocks
from residual.diagnosis.search import Search, SearchRun, add_curves, is_curve, refine_last_shape
from residual.effects.base import Effect, EffectTrait
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
from residual.model.nominal import FitLogs, NominalModel
from residual.recording import Array
from residual.verdict.result import Splits

PARTS = 3  # of the logs, left out in turn


@dataclass(frozen=True, eq=False, slots=True)
class Member:
    """One named effect on one joint, or of the whole arm."""

    group: CandidateColumns  # the effect, joints and shape
    nats: float  # its evidence within the set
    by: str  # "fit" or "plausibility"
    joint: int  # the joint (from 0) with its largest effect
    # Joint (from 0) whose left-out error falls most: without the name the parameters
    # adapt, which may show elsewhere.
    shown_joint: int
    probability: float  # of its class against all other names and none
    equivalent: tuple[CandidateColumns, ...]  # its equivalents by blocks
    splits: Splits  # number of thirds of the logs without which it is supported


@dataclass(frozen=True, eq=False, slots=True)
class Selection:
    """The likeliest set, other likely names, and their priors."""

    search: Search  # data, prior and candidates of the likeliest set
    fit: Fit  # its fit, curves left out
    members: tuple[Member, ...]  # its names, most certain first
    curves: tuple[CandidateColumns, ...]  # joints explained by a curve without a name
    # Scale of the rigid part: the evidence-weighted median; the widest that counts.
    scale: float
    wide: NominalPrior


def select_names(
    logs: FitLogs, nominal: NominalModel, progress: Callable[[float], None]
) -> Selection:
    """Search the logs for effects missing from the nominal model."""
    design = Design(
        logs.tracks,
        nominal.model,
        labels=label_blocks(logs.tracks),
        shaken=logs.shaken if _is_torque_shaken(logs, nominal) else (),
    )
    first = build_relative_prior(design, nominal, THRESHOLDS.rough_scale)
    design.set_torque_model(build_fitted_model(nominal, fit_nominal(design, first)))
    candidates = build_candidates(design, nominal, logs.span, logs.clock is not None)
    curves = add_curves(design, logs.tracks, centred=nominal.constants > 0)
    space = PriorSpace(design, nominal)

    def search(prior: NominalPrior) -> Search:
        allowed = candidates.without(tuple(space.list_barred_effects(prior)))
        return Search(Score(design, prior), allowed, curves)

    runs: dict[tuple, SearchRun] = {}

    def run(prior: NominalPrior, near: Sequence[CandidateColumns] = ()) -> SearchRun:
        key = prior.scale, tuple(sorted(prior.widths.items()))
        if key not in runs:
            here = search(prior)
            runs[key] = here.run(here.select_allowed(near))
            progress(len(runs) / (len(runs) + 3))
        return runs[key]

    # Columns that depend on the model's torque use it with the first findings.
    if _reads_torque(found := run(first)):
        _settle_torque_model(found, nominal)
        candidates = recompute_candidates(design, candidates)
        runs.clear()

    # From free to exact: if values are worse than a scale, its prediction is poor too.
    # At scales fine enough for names of bodies, such a name may correct it.
    for rough in (True, False):
        own: list[SearchRun] = []
        for scale in reversed(space.scales):
            if (scale > THRESHOLDS.rough_scale) == rough:
                own.append(run(space.at(scale, space.even[0])))
                if _falls_behind(own):
                    break
    weighted = _weigh(design, candidates, list(runs.values()))
    if others := _other_widths(space, weighted):
        scales = [prior.scale for prior in weighted.list_near()]
        # With other widths a search starts from the best set; at another scale it does not,
        # since a wrong set of one scale may persist at the next.
        near = weighted.best.fit.members
        for prior in others:
            run(prior, near)
        # The gain of the best widths at one scale counts for its rivals too.
        best = _weigh(design, candidates, list(runs.values())).best
        for scale in scales:
            run(space.at(scale, best.score.prior.widths), best.fit.members)
        weighted = _weigh(design, candidates, list(runs.values()))
    constants = _Constants.of(design, nominal, curves)
    return _conclude(logs, nominal, weighted, search, constants, runs)


def _is_torque_shaken(logs: FitLogs, nominal: NominalModel) -> bool:
    """Whether noise of the angles causes torque noise comparable to that of the sensor."""
    angles = torque_from_angle_noise(nominal.model, logs.tracks, logs.shaken)
    noise = np.sqrt(np.mean([t.torque_noise**2 for t in logs.tracks], axis=0))
    return bool((angles > THRESHOLDS.shaken_share * noise).any())


def _reads_torque(found: SearchRun) -> bool:
    """Whether a finding shifts columns that depend on the model's torque."""
    design = found.score.design
    shares = [float(design.torque_shares(g, found.fit.of(g)).max()) for g in found.named]
    uses = [EffectTrait.USES_MODEL in g.effect.traits for g in found.named]
    return any(uses) or max(shares, default=0.0) > THRESHOLDS.large_torque_share


def _settle_torque_model(found: SearchRun, nominal: NominalModel) -> None:
    """Iterate the torque model of the design with the named effects: Gauss-Newton."""
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

    runs: tuple[SearchRun, ...]
    share: tuple[float, ...]  # of the evidence

    @property
    def best(self) -> SearchRun:
        """The run with the most evidence."""
        return self.runs[0]

    def list_near(self) -> list[NominalPrior]:
        """Priors within 6 nats of the best."""
        least = self.share[0] * np.exp(-THRESHOLDS.class_nats)
        pairs = zip(self.runs, self.share, strict=True)
        return [run.score.prior for run, share in pairs if share >= least]


def _weigh(design: Design, candidates: Candidates, runs: Sequence[SearchRun]) -> Weighted:
    """Weigh runs by evidence, each name priced."""
    power = np.maximum(design.power.sum(axis=0), 1e-30)
    first = min(runs, key=lambda r: float((r.left_out.errors / power).sum()))
    lefts = [replace(r.left_out, weight=first.left_out.weight) for r in runs]
    best = min(lefts, key=lambda x: x.total)
    same = [r for r, x in zip(runs, lefts, strict=True) if _predicts_as_well(x, best)]
    counted = np.max([r.fit.counted for r in runs], axis=0)

    def evidence(run: SearchRun) -> float:
        prior, start = run.score.prior, run.fit.variance
        members = run.fit.members
        common = fit_jointly(design, prior, members, counted, start, rounds=4)
        search = Search(run.score, candidates, ())
        return common.score - sum(search.cost(g) for g in members)

    values = np.array([evidence(r) for r in same])
    order = np.argsort(-values)
    share = np.exp(values[order] - values.max())
    share /= share.sum()
    return Weighted(tuple(same[i] for i in order), tuple(share.tolist()))


def _predicts_as_well(left: LeftOut, best: LeftOut) -> bool:
    loss = best.gain_over(left)
    if loss.sum() <= THRESHOLDS.paired_deviations * compute_scatter(loss):
        return True
    return left.total < (1 + THRESHOLDS.same_share) * best.total


def _falls_behind(runs: Sequence[SearchRun]) -> bool:
    """Whether the last run predicts left-out blocks clearly worse than the best."""
    weight = runs[-1].left_out.weight
    lefts = [replace(r.left_out, weight=weight) for r in runs]
    best = min(lefts, key=lambda x: x.total)
    behind = lefts[-1].total > (1 + THRESHOLDS.hopeless_share) * best.total
    return behind and not _predicts_as_well(lefts[-1], best)


def _other_widths(space: PriorSpace, weighted: Weighted) -> list[NominalPrior]:
    """Yield priors with other widths of given values, one kind at a time."""
    if not space.free or not weighted.best.score.prior.widths:
        return []
    prior = weighted.best.score.prior
    out = [space.at(prior.scale, widths) for widths in space.even]
    kinds = prior.widths if len(prior.widths) > 1 else ()
    trials = [
        space.at(prior.scale, {**prior.widths, kind: width}) for kind in kinds for width in WIDTHS
    ]
    fitted, members = weighted.best.fit, weighted.best.fit.members

    def score(one: NominalPrior) -> float:
        return fit_jointly(
            space.design, one, members, fitted.counted, fitted.variance, rounds=4
        ).score

    return out + sorted(trials, key=score, reverse=True)[: THRESHOLDS.width_rounds]


@dataclass(frozen=True, eq=False, slots=True)
class _Constants:
    """The design with the constants of joints as candidates, not in the model."""

    space: PriorSpace
    groups: tuple[CandidateColumns, ...]
    curves: Sequence[CandidateColumns]

    @classmethod
    def of(
        cls, design: Design, nominal: NominalModel, curves: Sequence[CandidateColumns]
    ) -> "_Constants":
        """Move the constants out of the model, without computing columns."""
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
    logs: FitLogs,
    nominal: NominalModel,
    weighted: Weighted,
    search: Callable[[NominalPrior], Search],
    constants: _Constants,
    runs: Mapping[tuple, SearchRun],
) -> Selection:
    """The likeliest set with the probability of each name."""
    priors = [r.score.prior for r in weighted.runs]
    look = constants.search(search(weighted.best.score.prior))
    found = weighted.best.fit.members
    named = _drop_curved_constants(look.score, found, constants.groups)
    best, former = _join_constants(look, found, named)
    best, new = _replace_constants(look, best, named)
    former |= new
    for group in best.named:
        plain = look.name_plainly(best, group)
        for other in set(plain.named) - set(best.named):
            former[other] = former.get(group, group.effect)
        best = plain
    doubted = set(_find_doubted_joints(logs, nominal.without_constants(), best))
    members = judge_members(look, best, weighted, doubted, former)
    scores = [constants.score(r.score.prior) for r in runs.values()]
    sure = [m.group for m in members if m.probability >= THRESHOLDS.sure_probability]
    score = _choose_predictive_scale(best, sure, scores)
    # Sizes are corrected for the noise one by one, since it may shift them far.
    score = replace(score, design=score.design.keep_angle_noise())
    scales = sorted(zip([p.scale for p in priors], weighted.share, strict=True))
    middle = np.searchsorted(np.cumsum([s for _, s in scales]), 0.5)
    wide = _find_widest_prior(constants.space, weighted)
    return Selection(
        replace(look, score=score),
        score.fit([m.group for m in members], best.fit),
        members,
        best.curves,
        scales[min(int(middle), len(scales) - 1)][0],
        wide,
    )


def _find_widest_prior(space: PriorSpace, weighted: Weighted) -> NominalPrior:
    """The widest prior within 6 nats, at least 10 % if the scale is open.

    The error of given values can be estimated only for visible ones; those that trade
    off against a load are not.
    """
    wide = max(weighted.list_near(), key=lambda prior: prior.scale)
    scale = max(wide.scale, min(THRESHOLDS.rough_scale, space.scales[-1]))
    return space.at(scale, wide.widths)


def _join_constants(
    look: Search, found: Sequence[CandidateColumns], constants: Sequence[CandidateColumns]
) -> tuple[SearchRun, dict[CandidateColumns, Effect]]:
    """Add the constants that carry their price to the names.

    Without a free constant another name may be right: a balancer and a constant equal a
    spring with another rest position. The most evidence less its price wins.

    Returns:
        The set, and for each name that replaced another the replaced effect.
    """
    best, former = look.settle((*found, *constants)), {}
    for group in found:
        beside = [g for g in constants if g.joints == group.joints]
        if is_curve(group) or not any(g in best.fit.members for g in beside):
            continue
        rest = tuple(g for g in best.fit.members if g is not group and g not in beside)
        base = look.score.fit(rest, best.fit)
        for trial in look.look(base, group, THRESHOLDS.class_looks):
            if is_curve(trial.group) or trial.group.parts:
                continue
            other = look.settle((*rest, trial.group, *beside))
            if look.leads(other.fit, best.fit):
                best, former[trial.group] = other, group.effect
    return best, former


def _replace_constants(
    look: Search, best: SearchRun, constants: Sequence[CandidateColumns]
) -> tuple[SearchRun, dict[CandidateColumns, Effect]]:
    """Search for names hidden by a free constant, on joints without a named constant.

    A spring at rest in the middle of the motion is close to a constant: with a free
    constant it may not carry its price, and the constant may not either.

    Returns:
        The set, and of each new name the constant's effect.
    """
    fallen = {g.joints: g.effect for g in constants if g not in best.fit.members}
    groups = tuple(g for g in look.candidates.groups if g.joints in fallen and not g.parts)
    candidates = replace(look.candidates, groups=groups)
    found = replace(look, candidates=candidates, curves=()).run(best.fit.members)
    new = (g for g in found.named if g not in best.fit.members)
    return found, {g: fallen[g.joints] for g in new}


def _find_doubted_joints(logs: FitLogs, nominal: NominalModel, best: SearchRun) -> tuple[int, ...]:
    """Joints (from 0) with a residual above noise after the names."""
    named = _without_curves(best.score, best.fit)
    model = build_fitted_model(nominal, named)
    angles = torque_from_angle_noise(model, logs.tracks, logs.shaken)
    plain, design = best.score.fit((), named), best.score.design
    return assess_adequacy(design, logs.tracks, plain, named, angles).doubted


def _drop_curved_constants(
    score: Score, found: Sequence[CandidateColumns], groups: Sequence[CandidateColumns]
) -> list[CandidateColumns]:
    """Drop the constants of joints with a curve, where they are poorly determined.

    A constant must explain most of the joint explanation of it and the curve.
    """
    out = []
    for group in groups:
        curves = [g for g in found if is_curve(g) and g.joints == group.joints]
        if curves:
            others = [g for g in found if g not in curves]
            sets = (others, [*others, group], [*others, group, *curves])
            lefts = [score.left_out(score.fit(members)) for members in sets]
            none, alone, both = (x.errors[:, group.joints[0]].sum() for x in lefts)
            if none - alone < THRESHOLDS.explained_share * (none - both):
                continue
        out.append(group)
    return out


def _choose_predictive_scale(
    best: SearchRun, names: Sequence[CandidateColumns], scores: Sequence[Score]
) -> Score:
    """Choose the prior under which the names predict left-out blocks best.

    Evidence compares scales as if the residual were noise only; on a measured arm it is
    not. Another prior must save at least ``min_share`` of the left-out error.
    """
    chosen = best.score
    fitted = chosen.fit(names, best.fit)
    left = chosen.left_out(fitted)
    least = left.total * (1 - THRESHOLDS.min_share)
    for score in scores:
        other = score.left_out(score.fit(names, fitted))
        if (total := replace(other, weight=left.weight).total) < least:
            chosen, least = score, total
    return chosen


@dataclass(frozen=True, eq=False, slots=True)
class _Part:
    """A set fitted to some of the blocks."""

    score: Score
    fit: Fit
    covariances: list[tuple[Array, float]]


def _fit_parts(score: Score, fitted: Fit) -> list[_Part]:
    """Fit a set without each third of the blocks."""
    every, out = np.arange(score.design.folds), []
    for third in np.array_split(every, PARTS):
        part = replace(score, design=score.design.part(np.setdiff1d(every, third)))
        own = part.fit_like(fitted.members, fitted)
        out.append(_Part(part, own, part.covariances(own)))
    return out


def judge_members(
    look: Search,
    best: SearchRun,
    weighted: Weighted,
    doubted: set[int],
    former: Mapping[CandidateColumns, Effect],
) -> tuple[Member, ...]:
    """Rate every name of a set by evidence and probability, most certain first.

    Args:
        doubted: Joints (from 0) with a residual above noise.
        former: Effects that a name replaced when constants became candidates.
    """
    parts = _fit_parts(best.score, best.fit)
    members = (
        _judge(look, best, weighted, g, doubted, parts, former.get(g, g.effect)) for g in best.named
    )
    return tuple(sorted(members, key=lambda m: -m.probability))


def _judge(
    look: Search,
    best: SearchRun,
    weighted: Weighted,
    group: CandidateColumns,
    doubted: set[int],
    parts: Sequence[_Part],
    former: Effect,
) -> Member:
    """Evidence, equivalents and probability of one name.

    Args:
        former: Effect that it replaced when constants became candidates: the searches
            with a free constant contain that one.
    """
    score, fitted, left = best.score, best.fit, best.left_out
    rest = tuple(g for g in fitted.members if g is not group)
    without = score.fit(rest, fitted)
    bare = replace(score.left_out(without), weight=left.weight)
    removed = float(left.gain_over(bare).sum())
    near, nats = [], score.nats(fitted, group)
    for trial in look.look(without, group, THRESHOLDS.class_looks):
        if is_curve(trial.group) or trial.nats < nats / 2:
            continue
        if is_alike(left.gain_over(trial.left_out)):
            near.append(trial.group)
    alike = {group.effect.name, former.name, *(g.effect.name for g in near)}
    # A constant is free in every run.
    constant = EffectTrait.CONSTANT in group.effect.traits | former.traits
    stands = constant or sum(
        share
        for run, share in zip(weighted.runs, weighted.share, strict=True)
        if any(_same_place(g, group) and g.effect.name in alike for g in run.named)
    )
    fall = np.maximum((bare.errors - left.errors).sum(axis=0), 0.0)
    shares = score.design.torque_shares(group, fitted.of(group))
    spared = without.bent - fitted.bent
    return Member(
        group,
        nats,
        "plausibility" if spared > removed else "fit",
        int(np.argmax(shares)),
        int(np.argmax(fall / score.design.tau_power.sum(axis=0).clip(1e-30))),
        float(stands) * name_probability(nats, bool(doubted & set(look.rows(group)))),
        tuple(near),
        Splits(
            sum(p.score.nats(p.fit, group, p.covariances) > look.cost(group) for p in parts), PARTS
        ),
    )


def _same_place(first: CandidateColumns, second: CandidateColumns) -> bool:
    whole = not first.joints or not second.joints
    return whole or first.joints == second.joints


def name_probability(nats: float, doubted: bool = True) -> float:
    """Probability of a name by its evidence: logistic in ln(nats).

    Args:
        doubted: Whether a joint on which it acts has a residual above noise: errors of
            blocks are then less independent than assumed.
    """
    even = THRESHOLDS.even_nats if doubted else THRESHOLDS.clean_even_nats
    odds = THRESHOLDS.odds_slope * np.log(max(nats, 1e-3) / even)
    return float(1 / (1 + np.exp(-odds)))
