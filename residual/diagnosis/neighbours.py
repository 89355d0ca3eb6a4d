"""Sets of effects near the one that was found: better ones, and those as good.

A greedy search takes one effect after another, and what two changes do together one
of another name may do almost as well. So near its end members are swapped one for
one, one for two and two for one, and every set pays alike:

score(S) = log evidence - sum over S of (price + threshold)

which is the threshold that a single name must pass, as a prior over sets.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.linalg import solve_triangular

from residual.diagnosis.search import (
    FIRST_LOOKS,
    Task,
    joints_acted_on,
    rank_additions,
    refine_shape,
)
from residual.evidence.design import Group
from residual.evidence.fit import Fit, System, possible
from residual.evidence.priors import overlap, stacks
from residual.evidence.rules import THRESHOLDS
from residual.recording import Array
from residual.verdict.result import Detectable

FIRST, SECOND = 2, 1  # candidates tried for the first place and for the second
FAR = 2 * THRESHOLDS.class_nats  # nats from where a set is not worth a closer look

Members = tuple[Group, ...]


def alternatives(task: Task, fitted: Fit, group: Group) -> tuple[list[Group], float]:
    """What could stand in a member's place, and how sure its class is.

    Returns:
        Candidates within 6 nats of the member when swapped in, nearest first; the
        probability of that class against every other candidate and against nothing.
    """
    if (fitted, group) not in task.alternatives:
        task.alternatives[fitted, group] = _alternatives(task, fitted, group)
    return task.alternatives[fitted, group]


def _alternatives(task: Task, fitted: Fit, group: Group) -> tuple[list[Group], float]:
    rest = [g for g in fitted.members if g is not group]
    without = task.fit(rest, fitted)
    own = task.net_gain(fitted, without, group)
    ranked = rank_additions(task, without, instead=group)
    had = np.maximum(without.sse, 1e-30)
    removed = np.maximum(without.sse - fitted.sse, 0) / had
    joint = int(np.argmax(removed))

    def stands_in(value: float, big: Fit) -> bool:
        """It explains what the member explains, and not something else beside it."""
        fall = (without.sse[joint] - big.sse[joint]) / had[joint]
        return own - value < THRESHOLDS.class_nats and fall > 0.5 * removed[joint]

    near = [g for value, g, big in ranked if stands_in(value, big)]
    far = [value for value, g, _ in ranked if g not in near]
    inside = np.exp([0.0, *(min(v - own, 50) for v, g, _ in ranked if g in near)]).sum()
    outside = np.exp([min(v - own, 50) for v in [0.0, *far]]).sum()
    return near, float(inside / (inside + outside))


def prefer_simpler(task: Task, fitted: Fit) -> Fit:
    """Prefer the simpler of two names that the data cannot tell apart.

    A member gives way to an alternative with fewer coefficients and shape parameters
    that explains the same within 3 nats (odds of 20 to 1).
    """
    for group in fitted.members:
        rest = [g for g in fitted.members if g is not group]
        without = task.fit(rest, fitted)
        # Priced as if alone: one of several joints has no lead over its alternative.
        own = task.net_gain(fitted, without, replace(group, fellows=1))
        for value, other, _ in rank_additions(task, without, instead=group):
            if own - value < THRESHOLDS.simpler_nats and _size(other) < _size(group):
                stand_in = replace(other, fellows=group.fellows)
                fitted = task.settle(task.fit((*rest, stand_in), without))
                break
    return fitted


def _size(group: Group) -> float:
    """Number of free numbers of a group, and how far-fetched it is beside others."""
    shape = group.effect.refine is not None
    return len(group.ids) + shape + group.effect.far_fetched


@dataclass(frozen=True, eq=False, slots=True)
class Rival:
    """Another set that the logs cannot tell from the one named."""

    members: Members  # its effects
    nats: float  # its score over that of the named set [nats]
    twin: bool = False  # whether the two differ by what these logs cannot show at all


def best_set(task: Task, fitted: Fit) -> Fit:
    """Move to a better set near the one found, as long as there is one."""
    if any(g.fellows > 1 for g in fitted.members):
        return fitted
    for _ in range(THRESHOLDS.set_rounds if fitted.members else 0):
        own = _set_score(task, fitted)
        top = max(
            _neighboring_fits(task, fitted),
            key=lambda f: _set_score(task, f),
            default=fitted,
        )
        if _set_score(task, top) < own + THRESHOLDS.better_set_nats or not all(
            possible(task.design, top, g) for g in top.members
        ):
            break
        fitted = task.settle(task.fit(top.members, top))
    return fitted


def rivals(task: Task, fitted: Fit, least: Sequence[Detectable]) -> list[Rival]:
    """Return all sets within 6 nats of the one named, nearest first."""
    if not fitted.members or any(g.fellows > 1 for g in fitted.members):
        return []
    near, twins = near_sets(task, fitted), _body_twins(task, fitted, least)
    known = {_places_of(r.members) for r in near}
    return [*near, *(r for r in twins if _places_of(r.members) not in known)]


def near_sets(task: Task, fitted: Fit) -> list[Rival]:
    """Return the sets of those that another motion may tell from the one named."""
    if not fitted.members or any(g.fellows > 1 for g in fitted.members):
        return []
    if fitted not in task.near_sets:
        task.near_sets[fitted] = _near_sets(task, fitted)
    return task.near_sets[fitted]


def _near_sets(task: Task, fitted: Fit) -> list[Rival]:
    own, found = _set_score(task, fitted), {}
    for other in _neighboring_fits(task, fitted):
        gap = _set_score(task, other) - own
        key = _places_of(other.members)
        if gap > -THRESHOLDS.class_nats and key != _places_of(fitted.members):
            known = found.get(key)
            if known is None or gap > known.nats:
                found[key] = Rival(other.members, gap)
    return sorted(found.values(), key=lambda r: -r.nats)


def _neighboring_fits(task: Task, fitted: Fit) -> Iterator[Fit]:
    """Sets one move away: another for one, two for one, one for two, one less."""
    members = fitted.members
    for group in members:
        rest = tuple(g for g in members if g is not group)
        without = task.fit(rest, fitted)
        yield without
        ranked = rank_additions(task, without, instead=group, looks=FIRST_LOOKS)
        for _, other, _ in ranked[:FIRST]:
            swapped = _fit_with(task, rest, other, without)
            yield swapped
            for _, second, _ in _other_additions(task, swapped, (group,))[:SECOND]:
                yield _fit_with(task, swapped.members, second, swapped)
    for one, two in combinations(members, 2):
        if joints_acted_on(task, one) & joints_acted_on(task, two):
            rest = tuple(g for g in members if g is not one and g is not two)
            without = task.fit(rest, fitted)
            for _, other, _ in _other_additions(task, without, (one, two))[:FIRST]:
                yield _fit_with(task, rest, other, without)


def _other_additions(task: Task, base: Fit, gone: Sequence[Group]) -> list:
    """Candidates on top of a fit that are none of those taken out."""
    keys = {g.key for g in gone}
    ranked = rank_additions(task, base, looks=FIRST_LOOKS)
    return [one for one in ranked if not one[1].parts and one[1].key not in keys]


def _fit_with(task: Task, rest: Sequence[Group], other: Group, like: Fit) -> Fit:
    return task.fit(refine_shape(task, (*rest, other), like), like)


def _set_score(task: Task, fitted: Fit) -> float:
    price = sum(task.candidates.cost(g) + task.rules.min_nats for g in fitted.members)
    return fitted.score - price


def _places_of(members: Sequence[Group]) -> tuple:
    return tuple(sorted((g.effect.name, g.joints) for g in members))


def _body_twins(task: Task, fitted: Fit, least: Sequence[Detectable]) -> list[Rival]:
    """Sets with one more change of a body that the named ones take up unseen.

    A smaller load and a heavier link do what a load does; no evidence chooses, only
    the price of one more name.
    """
    heavy = [g for g in fitted.members if g.effect.portable.bodies is not None]
    taken = _places_of(fitted.members)
    others = [
        g
        for g in task.candidates.groups
        if g.effect.portable.bodies is not None
        and not g.parts
        and (g.effect.name, g.joints) not in taken
        and len(g.ids) == 1
    ]
    if not heavy or not others:
        return []
    rest = [g for g in fitted.members if g not in heavy]
    alone = _information(task, fitted, rest, others)
    beside = _information(task, fitted, fitted.members, others)
    out = []
    for other, before, after in zip(others, alone, beside, strict=True):
        cost = task.candidates.cost(other) + task.rules.min_nats
        # Clear without the named bodies, which take it up: not to be found beside them.
        clear, taken_up = (
            0.5 * THRESHOLDS.body_change_share**2 * before > cost,
            after < THRESHOLDS.absorbed_share * before,
        )
        if clear and taken_up and _is_hidden(other, least):
            out.append(Rival((*fitted.members, other), -cost, twin=True))
    return out


def _is_hidden(other: Group, least: Sequence[Detectable]) -> bool:
    """Whether a usual change of a body would not be found."""
    place = other.effect.name, tuple(j + 1 for j in other.joints)
    sizes = [d.value for d in least if (d.name, d.joints) == place]
    return not any(
        size is not None and size < THRESHOLDS.body_change_share for size in sizes
    )


def _information(
    task: Task, fitted: Fit, members: Sequence[Group], others: Sequence[Group]
) -> Array:
    """What logs hold of each candidate that a set cannot take up. Shape (g,)."""
    weight = fitted.weight(task.design.rows)
    system = System.of(task.design, task.prior, members)
    shared = overlap(task.design, system, weight)
    half = solve_triangular(system.solve(weight)[1], shared, lower=True)
    out = np.empty(len(others))
    for stack in stacks(task.design, others):
        out[stack.members] = stack.beyond(weight, half)[:, 0, 0]
    return out
