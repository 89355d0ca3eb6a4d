"""Search for the set of effects with the most evidence: add, refine, swap, delete.

A greedy search in the model space of `evidence.fit` (stepwise Bayesian selection, as in
orthogonal least squares; Chen, Billings and Luo 1989). A candidate c joins the set S if

    ln p(S + c) - ln p(S) - ln K - ln V_c >= min_nats

with K the number of candidates and V_c the number of shapes of c: the price of choosing
the best of many (a uniform prior over them). It must also lower the error of a joint,
or spare the nominal parameters. Quadratic forms on Gram matrices screen all candidates
at once (`screen_candidates`); only the best few are fitted, and only the winner's shape
is refined. After each addition a member gives way to a better
candidate, and members that lost their evidence are deleted.
"""

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from residual.effects import load_effects
from residual.effects.base import Effect, EffectTrait, MotionSpan, PlacedEffect
from residual.evidence.columns import merge_groups
from residual.evidence.design import CandidateColumns, Design
from residual.evidence.fit import (
    Fit,
    FitEquations,
    NominalPrior,
    compute_evidence_gain,
    fit_jointly,
    fit_nominal,
    is_fit_possible,
    refit_effective_rows,
)
from residual.evidence.priors import (
    list_first_priors,
    list_forbidden_effects,
    screen_candidates,
    select_acting_groups,
    widen_group_prior,
)
from residual.evidence.thresholds import THRESHOLDS, EvidenceThresholds
from residual.model.nominal import NominalModel
from residual.recording import Array

FIRST_LOOKS = 4  # admissible candidates to look at where one is to be chosen

# Which effects may be blamed, on which joints, and what a wider choice costs.


@dataclass(frozen=True, eq=False, slots=True)
class Candidates:
    """Every candidate finding with its price."""

    # All of them: each shape of each effect on each joint, then the effects that are
    # also tried on all joints at once.
    groups: tuple[CandidateColumns, ...]
    price: Mapping[tuple, float]  # what choosing one of so many costs [nats], by key
    # Of each group its key, whether it is one of several joints, and its price [nats].
    keys: tuple[tuple, ...] = field(init=False)
    unions: Array = field(init=False)
    costs: Array = field(init=False)

    def __post_init__(self) -> None:
        every = self.groups
        object.__setattr__(self, "keys", tuple(g.key for g in every))
        object.__setattr__(self, "unions", np.array([bool(g.parts) for g in every]))
        object.__setattr__(self, "costs", np.array([self.cost(g) for g in every]))

    def cost(self, group: CandidateColumns) -> float:
        """Price of a group [nats]; joints that came together share one price."""
        return self.price[group.key] / group.fellows

    def beside(self, more: Sequence[CandidateColumns]) -> "Candidates":
        """The same with more of them."""
        price = float(np.log(len({*self.price, *(g.key for g in more)})))
        priced = {**self.price, **{g.key: price for g in more}}
        return replace(self, groups=(*self.groups, *more), price=priced)

    def without(self, names: Sequence[str]) -> "Candidates":
        """The same without some effects; itself where it has none of them."""
        if not any(g.effect.name in names for g in self.groups):
            return self
        kept = tuple(g for g in self.groups if g.effect.name not in names)
        return replace(self, groups=kept)

    def exclude_joints(
        self, joints: Collection[int], bodies: bool = True
    ) -> "Candidates":
        """The same without what sits on some joints, alone or among others.

        Args:
            joints: The joints, from 0.
        """
        shut = set(joints)
        kept = (
            g
            for g in self.groups
            if not shut & set(g.joints)
            or not (bodies or g.effect.portable.bodies is None)
        )
        return replace(self, groups=tuple(kept))

    def exclude_groups(
        self, fallen: Sequence[CandidateColumns], kin: Sequence[CandidateColumns]
    ) -> "Candidates":
        """The same without some effects on their joints, alone or among others.

        Args:
            kin: Those of them with which all of their family on those joints goes: it
                would say the same, only worse.
        """
        keys = {g.key for g in fallen}
        families = {(g.effect.family, g.joints) for g in kin if g.effect.family}

        def falls(group: CandidateColumns) -> bool:
            own = group.effect.family, group.joints
            return group.key in keys or own in families

        kept = (g for g in self.groups if not any(map(falls, g.parts or (g,))))
        return replace(self, groups=tuple(kept))


def collect_candidates(
    design: Design, effects: Sequence[Effect], span: MotionSpan, dof: int
) -> Candidates:
    """Append the columns of all candidates to the design.

    A key costs the logarithm of the number of keys, and its shapes that of their
    number: the evidence of the best of many is worth so much less.
    """
    placed = []
    for effect in effects:
        for joints in effect.candidates(dof, span.prismatic):
            anchor = joints[0] if joints else 0
            shapes = effect.shapes(span, anchor)
            placed += [PlacedEffect(effect, joints, shape) for shape in shapes]
    groups = design.add(placed)
    # Linear local effects that usually sit on every joint, as one candidate.
    single: dict[str, list[CandidateColumns]] = {}
    for g in groups:
        if EffectTrait.GROUPABLE in g.effect.traits and g.shape == ():
            single.setdefault(g.effect.name, []).append(g)
    together = [
        merge_groups(parts) for parts in single.values() if len(parts) == dof > 1
    ]
    groups += together
    variants = Counter(g.key for g in groups)
    price = {k: float(np.log(len(variants)) + np.log(n)) for k, n in variants.items()}
    # A model that lacks all that every drive has must gain it in one step, since each
    # alone leaves a residual in which the others cannot be seen.
    drive_groups = [g for g in together if g.effect.drive_order]
    for count in range(2, len(drive_groups) + 1):
        for some in combinations(drive_groups, count):
            parts = [part for g in some for part in g.parts]
            label = " + ".join(g.effect.name for g in some)
            groups.append(merge_groups(parts, label))
            price[groups[-1].key] = sum(price[g.key] for g in some)
    return Candidates(tuple(groups), price)


def recompute_candidates(design: Design, candidates: Candidates) -> Candidates:
    """The same candidates, seen with the model that the design looks with now.

    Only columns that read the model's torque are made anew.
    """
    reading = [
        g
        for g in candidates.groups
        if EffectTrait.USES_MODEL in g.effect.traits and not g.parts
    ]
    recomputed = design.add([g.placed for g in reading])
    new = {_place(g): group for g, group in zip(reading, recomputed, strict=True)}

    def of(group: CandidateColumns) -> CandidateColumns:
        if not any(_place(p) in new for p in group.parts):
            return new.get(_place(group), group)
        parts = [new.get(_place(p), p) for p in group.parts]
        return merge_groups(parts, group.label)

    return replace(candidates, groups=tuple(of(g) for g in candidates.groups))


def _place(group: CandidateColumns) -> tuple:
    return group.effect.name, group.joints, group.shape, len(group.parts)


def build_candidates(
    design: Design, nominal: NominalModel, span: MotionSpan, clocked: bool
) -> Candidates:
    """Append the columns of all effects that some prior allows.

    Args:
        clocked: Whether the order of the logs in time is known.
    """
    absent = EffectTrait.NONE if clocked else EffectTrait.NEEDS_CLOCK
    effects = [e for e in load_effects().values() if not e.traits & absent]
    barred = [
        list_forbidden_effects(p, nominal) for p in list_first_priors(design, nominal)
    ]
    allowed = [e for e in effects if not all(e.name in b for b in barred)]
    candidates = collect_candidates(design, allowed, span, design.dof)
    # Where all values of a kind are off, that is how good they are, and no effect.
    kinds = nominal.kinds
    groups = [
        g for g in candidates.groups if not any(p.effect.name in kinds for p in g.parts)
    ]
    candidates = replace(candidates, groups=tuple(groups))
    # Of joints that hardly move the logs say nothing.
    return candidates.exclude_joints(
        np.flatnonzero(design.rows < THRESHOLDS.min_rows), bodies=False
    )


@dataclass(frozen=True, eq=False, slots=True)
class SearchTask:
    """What a search works on: data, prior, candidates and rules.

    What stands in for a member of a fit, and which sets are near one, is computed once.
    """

    design: Design
    prior: NominalPrior
    candidates: Candidates
    rules: EvidenceThresholds
    alternatives: dict[
        tuple[Fit, CandidateColumns], tuple[list[CandidateColumns], float]
    ] = field(default_factory=dict, init=False)
    near_sets: dict[Fit, list] = field(default_factory=dict, init=False)

    def fit(
        self, members: Sequence[CandidateColumns], like: Fit, rounds: int = 3
    ) -> Fit:
        """Fit a set with the row counts and noise of another fit to start from."""
        counted, variance = like.counted, like.variance
        return fit_jointly(self.design, self.prior, members, counted, variance, rounds)

    def settle(self, fitted: Fit) -> Fit:
        """Count rows anew by the fit's own residual and fit again."""
        return refit_effective_rows(self.design, self.prior, fitted)

    def start(self) -> Fit:
        """Fit of the nominal structure alone."""
        return fit_nominal(self.design, self.prior)

    def net_gain(self, big: Fit, small: Fit, group: CandidateColumns) -> float:
        """Evidence of ``big`` over ``small`` less the price of the group [nats]."""
        value, _, _ = compute_evidence_gain(self.design, self.prior, big, small)
        return value - self.candidates.cost(group)


def search_effect_set(task: SearchTask, start: Fit | None = None) -> Fit:
    """Add the best effect while one is worth it; then swap and delete.

    Args:
        start: A fit of names to start from, with its noise: from the noise of the
            nominal structure alone the alternation may end at another fixed point,
            where a name that halves the torque carries nothing. Names go that do not
            carry their own weight.

    Returns:
        The fit of the chosen set, its members single-joint groups.
    """
    current, rules = task.start(), task.rules
    if start is not None and start.members:
        current = _delete(task, task.settle(task.fit(start.members, start)))
    for _ in range(rules.max_effects - len(current.members)):
        ranked = rank_additions(task, current, looks=FIRST_LOOKS)
        if not ranked or ranked[0][0] < rules.min_nats:
            break
        chosen = ranked[0][1]
        members = (*current.members, *(chosen.parts or (chosen,)))
        current = task.settle(
            task.fit(refine_last_shape(task, members, current), current)
        )
        if not chosen.parts:
            current = _swap(task, current, joints_acted_on(task, chosen))
        current = _delete(task, current)
    return current


def rank_additions(
    task: SearchTask,
    base: Fit,
    instead: CandidateColumns | None = None,
    looks: int | None = None,
) -> list[tuple[float, CandidateColumns, Fit]]:
    """Admissible additions to a fit, most evidence first: (net gain, group, fit).

    Args:
        instead: A member that was taken out: only what acts on its joints, and is not
            the same candidate, may stand in for it.
        looks: Of how many admissible ones the rows are counted anew, where the first
            is all that is wanted.
    """
    ranked = []
    base_system = FitEquations.of(task.design, task.prior, base.members)
    tried = [
        _try_candidate(task, base, g, base_system)
        for g in _shortlist(task, base, instead, base_system)
    ]
    tried.sort(key=lambda one: task.candidates.cost(one[0]) - one[1].score)
    for group, trial, system in tried:
        trial = replace(trial, counted=base.counted)
        value, big, small = compute_evidence_gain(
            task.design, task.prior, trial, base, (system, base_system)
        )
        value -= task.candidates.cost(group)
        if is_admissible(task, group, value, big, small):
            ranked.append((value, group, big))
        if len(ranked) == looks:
            break
    return sorted(ranked, key=lambda item: -item[0])


def _try_candidate(
    task: SearchTask, base: Fit, group: CandidateColumns, base_system: FitEquations
) -> tuple[CandidateColumns, Fit, FitEquations]:
    """Fit with a candidate, under a wide prior where it is far beyond the usual."""

    def trial(group: CandidateColumns) -> tuple[CandidateColumns, Fit, FitEquations]:
        system, members = base_system.beside(task.design, group), (*base.members, group)
        counted = task.design.rows / 4
        fitted = fit_jointly(task.design, task.prior, members, counted, system=system)
        return group, fitted, system

    standard = trial(group)
    wide = widen_group_prior(standard[1], group)
    return (
        standard
        if wide is None
        else max(standard, trial(wide), key=lambda t: t[1].score)
    )


def joints_acted_on(task: SearchTask, group: CandidateColumns) -> set[int]:
    """Joints on which a group's columns act."""
    return set(group.effect.rows(group.joints, task.design.dof))


def _shortlist(
    task: SearchTask,
    base: Fit,
    instead: CandidateColumns | None,
    base_system: FitEquations,
) -> list[CandidateColumns]:
    """The best shape of the most promising keys, at most a third of them per joint."""
    groups = task.candidates.groups
    values, floor = (
        screen_candidates(task.design, base, groups, base_system),
        task.rules.min_nats / 4,
    )
    if instead is not None:
        acting_too = select_acting_groups(
            task.design, groups, joints_acted_on(task, instead)
        )
        values = np.where(acting_too & ~task.candidates.unions, values, -np.inf)
        alike = values[[key == instead.key for key in task.candidates.keys]]
        floor = max(floor, THRESHOLDS.rival_share * alike.max(initial=0.0))
    values = values - task.candidates.costs
    if (
        instead is None
        and (top := values.max(initial=0.0)) > THRESHOLDS.clear_best_nats
    ):
        floor = max(floor, THRESHOLDS.faint_share * top)
    taken = {g.key for g in base.members if EffectTrait.PERIODIC not in g.effect.traits}
    if instead is not None:
        taken.add(instead.key)
    families = {(g.effect.family, g.joints) for g in base.members if g.effect.family}
    chosen, per_joint, limit = {}, {}, task.rules.max_exact_looks
    for i in np.argsort(-values):
        g = groups[i]
        if values[i] < floor or len(chosen) >= limit:
            break
        place = g.joints if len(g.joints) == 1 else ()
        barred = g.key in taken or g.key in chosen
        barred = barred or any(part.key in taken for part in g.parts)
        barred = barred or any(_neighbours(g, other) for other in base.members)
        if barred or (g.effect.family, g.joints) in families:
            continue
        if per_joint.get(place, 0) >= max(1, limit // 3):
            continue
        chosen[g.key] = g
        per_joint[place] = per_joint.get(place, 0) + 1
    return list(chosen.values())


def _neighbours(first: CandidateColumns, second: CandidateColumns) -> bool:
    """Whether two ripples of one joint have nearly the same order: they cancel."""
    if (
        first.effect is not second.effect
        or first.joints != second.joints
        or not first.shape
    ):
        return False
    ratio = first.shape[0] / second.shape[0]
    return 1 / THRESHOLDS.ripple_order_ratio < ratio < THRESHOLDS.ripple_order_ratio


def is_admissible(
    task: SearchTask, group: CandidateColumns, value: float, big: Fit, small: Fit
) -> bool:
    """Does the effect lower the error, or spare the model beyond belief?"""
    if not is_fit_possible(task.design, big, group):
        return False
    return lowers_error(task, big, small) or spares_model(
        task, group, value, big, small
    )


def lowers_error(task: SearchTask, big: Fit, small: Fit) -> bool:
    """The error of some joint falls by enough, of torque and of what was left."""
    design = task.design
    fall = np.maximum(small.sse - big.sse, 0)
    relative = np.sqrt(fall / design.rows) / design.rms
    share = fall / np.maximum(small.sse, 1e-300)
    return bool(np.any(task.rules.lower(relative, share)))


def spares_model(
    task: SearchTask, group: CandidateColumns, value: float, big: Fit, small: Fit
) -> bool:
    """The refit can imitate the effect, but only with implausible parameters."""
    rules = task.rules
    if (
        value < rules.min_plausible_nats
        or small.bent - big.bent < rules.min_prior_share * value
    ):
        return False
    return bool(
        member_torque_shares(task.design, big, group).max()
        >= rules.min_plausible_torque
    )


def member_torque_shares(design: Design, fitted: Fit, group: CandidateColumns) -> Array:
    """Rms torque of a member on each joint, as a share of torque rms. Shape (dof,)."""
    theta, out = fitted.of(group), np.zeros(design.dof)
    for j in range(design.dof):
        place, have = design.present(j, group.ids)
        if len(place):
            gram = design.total(j)[0][np.ix_(place, place)]
            power = theta[have] @ gram @ theta[have] / design.rows[j]
            out[j] = np.sqrt(max(power, 0.0)) / design.rms[j]
    return out


def refine_last_shape(
    task: SearchTask, members: Sequence[CandidateColumns], like: Fit
) -> tuple[CandidateColumns, ...]:
    """The set with the last member's nonlinear parameter searched off the grid."""
    *others, last = members
    how = last.effect.refine
    if how is None:
        return tuple(members)
    ratio = how.step == "ratio"
    reach = how.compute_half_width(last.joints, task.design.states[0].robot)
    offsets = np.linspace(-reach, reach, 7)
    base_system, size = (
        FitEquations.of(task.design, task.prior, others),
        task.design.size,
    )
    counted = task.design.rows / 4
    centre, winner, top = last.shape[0], last, -np.inf
    for _ in range(3):
        points = centre * np.exp(offsets) if ratio else centre + offsets
        points = np.unique(np.clip(points, how.lower, how.upper))
        shapes = [
            last.placed._replace(shape=(float(x), *last.shape[1:])) for x in points
        ]
        for group in task.design.add(shapes):
            trial = fit_jointly(
                task.design,
                task.prior,
                (*others, group),
                counted,
                like.variance,
                system=base_system.beside(task.design, group),
            )
            if trial.score > top and is_fit_possible(task.design, trial, group):
                top, winner = trial.score, group
        centre = winner.shape[0]
        offsets = np.array([-0.5, -0.2, 0.2, 0.5]) * (offsets[-1] - offsets[0]) / 6
    task.design.drop_newest_columns(size)  # of all that was tried one shape is kept
    if winner is not last:
        (winner,) = task.design.add([winner.placed])
    winner, *_ = _try_candidate(
        task, replace(like, members=tuple(others)), winner, base_system
    )
    return (*others, winner)


def _swap(task: SearchTask, current: Fit, where: set[int]) -> Fit:
    """Replace a member where another candidate explains the same better by 1 nat.

    Only members that share a joint with the last addition are looked at: nothing
    changed for the others. One of several joints that came together gives way to
    something else only for as much as a name of its own would need.
    """
    for _ in range(2):
        for group in current.members:
            if not where & joints_acted_on(task, group):
                continue
            others = tuple(g for g in current.members if g is not group)
            without = task.fit(others, current)
            member_nats = task.net_gain(current, without, group)
            ranked = rank_additions(task, without, instead=group, looks=FIRST_LOOKS)
            margin = 1.0 if group.fellows == 1 else task.rules.min_nats
            if ranked and ranked[0][0] > member_nats + margin:
                members = refine_last_shape(task, (*others, ranked[0][1]), without)
                current = task.settle(task.fit(members, without))
                break
        else:
            return current
    return current


def _delete(task: SearchTask, current: Fit) -> Fit:
    """Drop members that no longer carry their own weight.

    Members of a group that came together stay while they carry any: the name stands
    already, and what a joint still lacks makes its rows count for little.
    """
    for group in current.members:
        others = tuple(g for g in current.members if g is not group)
        without = task.fit(others, current)
        value, _, _ = compute_evidence_gain(task.design, task.prior, current, without)
        if value < required_nats(task, current.members, group):
            current = task.settle(without)
    return current


def required_nats(
    task: SearchTask, members: Sequence[CandidateColumns], group: CandidateColumns
) -> float:
    """Evidence that a member must carry to stay [nats].

    None for one of several joints, as long as half of the arm's joints have the name;
    what every drive has may even cost as much, since what a joint lacks may hide it.
    """
    if EffectTrait.CONSTANT in group.effect.traits:
        # Tested on left-out parts: a joint whose error it halves may have five rows
        # that count.
        return -np.inf
    name = group.effect.name
    fellows = [g for g in members if g.fellows > 1 and g.effect.name == name]
    enough = group in fellows and len(fellows) >= max(2, task.design.dof / 2)
    low = -task.rules.min_nats if group.effect.drive_order else 0.0
    return low if enough else task.rules.min_nats
