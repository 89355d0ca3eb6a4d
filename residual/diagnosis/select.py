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

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np
from scipy.linalg import solve_triangular

from residual.diagnosis.search import (
    FIRST_LOOKS,
    Candidates,
    SearchTask,
    joints_acted_on,
    rank_additions,
    refine_last_shape,
    search_effect_set,
)
from residual.evidence.design import CandidateColumns
from residual.evidence.fit import (
    Fit,
    FitEquations,
    NominalPrior,
    find_group_limits,
    fit_jointly,
    is_fit_possible,
)
from residual.evidence.priors import (
    WIDTHS,
    PriorSpace,
    stack_groups,
    weight_column_products,
)
from residual.evidence.thresholds import THRESHOLDS, EvidenceThresholds
from residual.recording import Array
from residual.robot.dynamics import PER_LINK
from residual.verdict.result import Detectable


@dataclass(frozen=True, eq=False, slots=True)
class Selection:
    """The search's result."""

    task: SearchTask  # data under the chosen prior
    fit: Fit  # its best fit
    # The widest prior that the logs do not contradict, for standard deviations.
    wide: NominalPrior


@dataclass(frozen=True, eq=False, slots=True)
class _SearchRuns:
    """Searches so far by the prior's scale and widths, and what each may name."""

    space: PriorSpace
    candidates: Candidates
    rules: EvidenceThresholds
    done: dict[tuple, Selection] = field(default_factory=dict)
    allowed: dict[frozenset[str], Candidates] = field(default_factory=dict)

    def search(self, prior: NominalPrior) -> None:
        """Search under a prior, unless that was done."""
        if (key := _key(prior)) not in self.done:
            barred = frozenset(self.space.list_barred_effects(prior))
            if barred not in self.allowed:
                self.allowed[barred] = self.candidates.without(tuple(barred))
            task = SearchTask(
                self.space.design, prior, self.allowed[barred], self.rules
            )
            self.done[key] = Selection(task, search_effect_set(task), prior)

    @property
    def counted(self) -> Array:
        """Rows of each joint, counted alike for all runs. Shape (dof,)."""
        return np.max([r.fit.counted for r in self.done.values()], axis=0)

    @property
    def best(self) -> Selection:
        """The run with the most evidence."""
        counted = self.counted
        return max(self.done.values(), key=lambda r: _comparable_score(r, counted))

    def score(self, prior: NominalPrior, run: Selection) -> float:
        """Evidence of a run's set under another prior [nats]."""
        members = run.fit.members
        return fit_jointly(
            self.space.design, prior, members, self.counted, rounds=4
        ).score


def _key(prior: NominalPrior) -> tuple:
    return prior.scale, tuple(sorted(prior.widths.items()))


def select_set_and_prior(
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

    def as_given(runs: _SearchRuns) -> Iterable[NominalPrior]:
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


def _even_widths(runs: _SearchRuns) -> Iterable[NominalPrior]:
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


def _by_kind(runs: _SearchRuns) -> Iterable[NominalPrior]:
    for _ in range(THRESHOLDS.width_rounds):
        best = runs.best
        if not runs.space.free or len(best.wide.widths) < 2:
            return
        turned = _best_widths(runs, best)
        if _key(turned) in runs.done:
            return
        yield turned


def _best_widths(runs: _SearchRuns, best: Selection) -> NominalPrior:
    """The prior with the best width of each kind, one after the other."""
    prior = best.wide
    for kind in best.wide.widths:
        trials = [
            runs.space.at(prior.scale, {**prior.widths, kind: width})
            for width in WIDTHS
        ]
        prior = max([prior, *trials], key=lambda p: runs.score(p, best))
    return prior


def _adjacent_scales(runs: _SearchRuns) -> Iterable[NominalPrior]:
    best, scales = runs.best.wide, runs.space.scales
    index = scales.index(best.scale)
    return [
        runs.space.at(s, best.widths) for s in scales[max(index - 1, 0) : index + 2]
    ]


def _widest_prior(runs: _SearchRuns, run: Selection) -> NominalPrior:
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


def neighbor_priors(space: PriorSpace, prior: NominalPrior) -> tuple[NominalPrior, ...]:
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
    common = fit_jointly(task.design, task.prior, members, counted, rounds=4)
    # What a name costs beside its choice: a link's, all that a name must win.
    price = (
        THRESHOLDS.nats_per_link if g.effect.replaces_link else THRESHOLDS.nats_per_name
        for g in members
    )
    costs = (task.candidates.cost(g) for g in members)
    return common.score - sum(a + b for a, b in zip(costs, price, strict=True))


# Sets of effects near the one that was found: better ones, and those as good.
#
# A greedy search takes one effect after another, and what two changes do together one
# of another name may do almost as well. So near its end members are swapped one for
# one, one for two and two for one, and every set pays alike:
#
# score(S) = log evidence - sum over S of (price + threshold)
#
# which is the threshold that a single name must pass, as a prior over sets.


FIRST, SECOND = 2, 1  # candidates tried for the first place and for the second
FAR = 2 * THRESHOLDS.class_nats  # nats from where a set is not worth a closer look

Members = tuple[CandidateColumns, ...]


def find_member_alternatives(
    task: SearchTask, fitted: Fit, group: CandidateColumns
) -> tuple[list[CandidateColumns], float]:
    """What could stand in a member's place, and how sure its class is.

    Returns:
        Candidates within 6 nats of the member when swapped in, nearest first; the
        probability of that class against every other candidate and against nothing.
    """
    if (fitted, group) not in task.alternatives:
        task.alternatives[fitted, group] = _alternatives(task, fitted, group)
    return task.alternatives[fitted, group]


def _alternatives(
    task: SearchTask, fitted: Fit, group: CandidateColumns
) -> tuple[list[CandidateColumns], float]:
    others = [g for g in fitted.members if g is not group]
    without = task.fit(others, fitted)
    member_nats = task.net_gain(fitted, without, group)
    ranked = rank_additions(task, without, instead=group)
    residual_power = np.maximum(without.sse, 1e-30)
    removed = np.maximum(without.sse - fitted.sse, 0) / residual_power
    joint = int(np.argmax(removed))

    def stands_in(value: float, big: Fit) -> bool:
        """It explains what the member explains, and not something else beside it."""
        fall = (without.sse[joint] - big.sse[joint]) / residual_power[joint]
        return (
            member_nats - value < THRESHOLDS.class_nats and fall > 0.5 * removed[joint]
        )

    near = [g for value, g, big in ranked if stands_in(value, big)]
    far = [value for value, g, _ in ranked if g not in near]
    inside = np.exp(
        [0.0, *(min(v - member_nats, 50) for v, g, _ in ranked if g in near)]
    ).sum()
    outside = np.exp([min(v - member_nats, 50) for v in [0.0, *far]]).sum()
    return near, float(inside / (inside + outside))


def find_load_alternatives(
    task: SearchTask, fitted: Fit, group: CandidateColumns
) -> list[CandidateColumns]:
    """Loads that add the very body that a heavier last link adds.

    Evidence prefers the name with one coefficient, but the torques are the same.
    """
    robot, add = task.design.model.robot, group.effect.portable.bodies
    if add is None:
        return []
    body, out = add(fitted.of(group), group.joints, robot), []
    taken = {g.key for g in fitted.members}
    for g in task.candidates.groups:
        add = g.effect.portable.bodies
        if g.effect.scope != "flange" or add is None or g.key in taken:
            continue
        unit = np.stack([add(x, g.joints, robot) for x in np.eye(len(g.ids))], axis=1)
        theta = unit.T @ body  # a coefficient is an inertial parameter of its link
        limits = find_group_limits(task.design, fitted, g)
        same = np.allclose(unit @ theta, body) and body[::PER_LINK].sum() > 0
        if same and g.effect.possible(theta, g.shape, limits):
            out.append(g)
    return out


def swap_for_simpler_names(task: SearchTask, fitted: Fit) -> Fit:
    """Prefer the simpler of two names that the data cannot tell apart.

    A member gives way to an alternative with fewer coefficients and shape parameters
    that explains the same within 3 nats (odds of 20 to 1).
    """
    for group in fitted.members:
        others = [g for g in fitted.members if g is not group]
        without = task.fit(others, fitted)
        # Priced as if alone: one of several joints has no lead over its alternative.
        member_nats = task.net_gain(fitted, without, replace(group, fellows=1))
        for value, candidate, _ in rank_additions(task, without, instead=group):
            if member_nats - value < THRESHOLDS.simpler_nats and _size(
                candidate
            ) < _size(group):
                stand_in = replace(candidate, fellows=group.fellows)
                fitted = task.settle(task.fit((*others, stand_in), without))
                break
    return fitted


def _size(group: CandidateColumns) -> float:
    """Number of free parameters of a group, and how far-fetched it is."""
    shape = group.effect.refine is not None
    return len(group.ids) + shape + group.effect.far_fetched


@dataclass(frozen=True, eq=False, slots=True)
class RivalSet:
    """Another set that the logs cannot tell from the one named."""

    members: Members  # its effects
    nats: float  # its score over that of the named set [nats]
    twin: bool = False  # whether the two differ by what these logs cannot show at all


def improve_set(task: SearchTask, fitted: Fit) -> Fit:
    """Move to a better set near the one found, as long as there is one."""
    if any(g.fellows > 1 for g in fitted.members):
        return fitted
    for _ in range(THRESHOLDS.set_rounds if fitted.members else 0):
        score = _set_score(task, fitted)
        best = max(
            _neighboring_fits(task, fitted),
            key=lambda f: _set_score(task, f),
            default=fitted,
        )
        if _set_score(task, best) < score + THRESHOLDS.better_set_nats or not all(
            is_fit_possible(task.design, best, g) for g in best.members
        ):
            break
        fitted = task.settle(task.fit(best.members, best))
    return fitted


def find_rival_sets(
    task: SearchTask, fitted: Fit, detectable: Sequence[Detectable]
) -> list[RivalSet]:
    """Return all sets within 6 nats of the one named, nearest first."""
    if not fitted.members or any(g.fellows > 1 for g in fitted.members):
        return []
    near, twins = (
        find_separable_sets(task, fitted),
        _body_twins(task, fitted, detectable),
    )
    known = {_places_of(r.members) for r in near}
    return [*near, *(r for r in twins if _places_of(r.members) not in known)]


def find_separable_sets(task: SearchTask, fitted: Fit) -> list[RivalSet]:
    """Return the sets of those that another motion may tell from the one named."""
    if not fitted.members or any(g.fellows > 1 for g in fitted.members):
        return []
    if fitted not in task.near_sets:
        task.near_sets[fitted] = _near_sets(task, fitted)
    return task.near_sets[fitted]


def _near_sets(task: SearchTask, fitted: Fit) -> list[RivalSet]:
    score, rivals = _set_score(task, fitted), {}
    for neighbor in _neighboring_fits(task, fitted):
        gap = _set_score(task, neighbor) - score
        key = _places_of(neighbor.members)
        if gap > -THRESHOLDS.class_nats and key != _places_of(fitted.members):
            rival = rivals.get(key)
            if rival is None or gap > rival.nats:
                rivals[key] = RivalSet(neighbor.members, gap)
    return sorted(rivals.values(), key=lambda r: -r.nats)


def _neighboring_fits(task: SearchTask, fitted: Fit) -> Iterator[Fit]:
    """Sets one move away: another for one, two for one, one for two, one less."""
    members = fitted.members
    for group in members:
        others = tuple(g for g in members if g is not group)
        without = task.fit(others, fitted)
        yield without
        ranked = rank_additions(task, without, instead=group, looks=FIRST_LOOKS)
        for _, candidate, _ in ranked[:FIRST]:
            swapped = _fit_with(task, others, candidate, without)
            yield swapped
            for _, second, _ in _other_additions(task, swapped, (group,))[:SECOND]:
                yield _fit_with(task, swapped.members, second, swapped)
    for first, second in combinations(members, 2):
        if joints_acted_on(task, first) & joints_acted_on(task, second):
            others = tuple(g for g in members if g is not first and g is not second)
            without = task.fit(others, fitted)
            for _, candidate, _ in _other_additions(task, without, (first, second))[
                :FIRST
            ]:
                yield _fit_with(task, others, candidate, without)


def _other_additions(
    task: SearchTask, base: Fit, gone: Sequence[CandidateColumns]
) -> list:
    """Additions to a fit that are not among the removed candidates."""
    keys = {g.key for g in gone}
    ranked = rank_additions(task, base, looks=FIRST_LOOKS)
    return [one for one in ranked if not one[1].parts and one[1].key not in keys]


def _fit_with(
    task: SearchTask,
    others: Sequence[CandidateColumns],
    candidate: CandidateColumns,
    like: Fit,
) -> Fit:
    return task.fit(refine_last_shape(task, (*others, candidate), like), like)


def _set_score(task: SearchTask, fitted: Fit) -> float:
    price = sum(task.candidates.cost(g) + task.rules.min_nats for g in fitted.members)
    return fitted.score - price


def _places_of(members: Sequence[CandidateColumns]) -> tuple:
    return tuple(sorted((g.effect.name, g.joints) for g in members))


def _body_twins(
    task: SearchTask, fitted: Fit, least: Sequence[Detectable]
) -> list[RivalSet]:
    """Sets with one more change of a body that the named ones take up unseen.

    A smaller load and a heavier link do what a load does; no evidence chooses, only
    the price of one more name.
    """
    bodies = [g for g in fitted.members if g.effect.portable.bodies is not None]
    taken = _places_of(fitted.members)
    candidates = [
        g
        for g in task.candidates.groups
        if g.effect.portable.bodies is not None
        and not g.parts
        and (g.effect.name, g.joints) not in taken
        and len(g.ids) == 1
    ]
    if not bodies or not candidates:
        return []
    non_bodies = [g for g in fitted.members if g not in bodies]
    without_bodies = _information(task, fitted, non_bodies, candidates)
    with_bodies = _information(task, fitted, fitted.members, candidates)
    out = []
    for candidate, before, after in zip(
        candidates, without_bodies, with_bodies, strict=True
    ):
        cost = task.candidates.cost(candidate) + task.rules.min_nats
        # Clear without the named bodies, which take it up: not to be found beside them.
        clear, taken_up = (
            0.5 * THRESHOLDS.body_change_share**2 * before > cost,
            after < THRESHOLDS.absorbed_share * before,
        )
        if clear and taken_up and _is_hidden(candidate, least):
            out.append(RivalSet((*fitted.members, candidate), -cost, twin=True))
    return out


def _is_hidden(candidate: CandidateColumns, least: Sequence[Detectable]) -> bool:
    """Whether the usual change of a body is below the detectable size."""
    place = candidate.effect.name, tuple(j + 1 for j in candidate.joints)
    sizes = [d.value for d in least if (d.name, d.joints) == place]
    return not any(
        size is not None and size < THRESHOLDS.body_change_share for size in sizes
    )


def _information(
    task: SearchTask,
    fitted: Fit,
    members: Sequence[CandidateColumns],
    candidates: Sequence[CandidateColumns],
) -> Array:
    """Information on each candidate beyond a set. Shape (g,)."""
    weight = fitted.weight(task.design.rows)
    system = FitEquations.of(task.design, task.prior, members)
    shared = weight_column_products(task.design, system, weight)
    half = solve_triangular(system.solve(weight)[1], shared, lower=True)
    out = np.empty(len(candidates))
    for stack in stack_groups(task.design, candidates):
        out[stack.members] = stack.beyond(weight, half)[:, 0, 0]
    return out
