"""Other sets of effects that the logs cannot separate from the named one.

Members are swapped one for one, one for two and two for one. Every set pays alike,

    score(S) = ln p(y | S) - sum over S of (price + threshold),

with the threshold of a single name as a prior over sets.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from residual.diagnosis.score import Score
from residual.diagnosis.search import Search, is_curve, places_of, refine_last_shape
from residual.evidence.columns import CandidateColumns
from residual.evidence.fit import Fit, FitEquations, find_group_limits
from residual.evidence.priors import project_columns, stack_groups
from residual.evidence.thresholds import THRESHOLDS
from residual.recording import Array
from residual.robot.dynamics import PER_LINK

FIRST, SECOND = 2, 1  # candidates tried for the first place and for the second
LOOKS = 4  # candidates after quick screening

Members = tuple[CandidateColumns, ...]


def find_load_alternatives(
    search: Search, fitted: Fit, group: CandidateColumns
) -> list[CandidateColumns]:
    """Find loads equal to the body that a heavier last link adds.

    Evidence prefers the name with one coefficient, but the torques are the same.
    """
    design = search.score.design
    robot, add = design.model.robot, group.effect.portable.bodies
    if add is None:
        return []
    body, out = add(fitted.of(group), group.joints, robot), []
    taken = {g.key for g in fitted.members}
    for g in search.candidates.groups:
        add = g.effect.portable.bodies
        if g.effect.scope != "flange" or add is None or g.key in taken:
            continue
        unit = np.stack([add(x, g.joints, robot) for x in np.eye(len(g.ids))], axis=1)
        theta = unit.T @ body  # a coefficient is an inertial parameter of its link
        limits = find_group_limits(design, fitted, g)
        same = np.allclose(unit @ theta, body) and body[::PER_LINK].sum() > 0
        if same and g.effect.possible(theta, g.shape, limits):
            out.append(g)
    return out


@dataclass(frozen=True, eq=False, slots=True)
class RivalSet:
    """Another set that the logs cannot separate from the named one."""

    members: Members  # its effects
    nats: float  # its score over that of the named set [nats]
    twin: bool = False  # whether these logs contain no information on the difference


def find_rival_sets(search: Search, fitted: Fit) -> list[RivalSet]:
    """Return all sets within 6 nats of the named one, nearest first."""
    near = find_separable_sets(search, fitted)
    known = {places_of(r.members) for r in near}
    twins = _body_twins(search, fitted)
    return [*near, *(r for r in twins if places_of(r.members) not in known)]


def find_separable_sets(search: Search, fitted: Fit) -> list[RivalSet]:
    """Return those sets that another motion may separate from the named one."""
    if not fitted.members or any(g.fellows > 1 for g in fitted.members):
        return []
    score, rivals = search.set_score(fitted), {}
    for neighbor in _neighboring_fits(search, fitted):
        gap = search.set_score(neighbor) - score
        key = places_of(neighbor.members)
        if gap > -THRESHOLDS.class_nats and key != places_of(fitted.members):
            rival = rivals.get(key)
            if rival is None or gap > rival.nats:
                rivals[key] = RivalSet(neighbor.members, gap)
    return sorted(rivals.values(), key=lambda r: -r.nats)


def _neighboring_fits(search: Search, fitted: Fit) -> Iterator[Fit]:
    """Sets one move away: another for one, two for one, one for two, one less."""
    score = search.score
    for group in fitted.members:
        others = tuple(g for g in fitted.members if g is not group)
        without = score.fit_like(others, fitted)
        yield without
        for candidate in _additions(search, without, (group,), group)[:FIRST]:
            swapped = _fit_with(score, others, candidate, without)
            yield swapped
            for second in _additions(search, swapped, (group,))[:SECOND]:
                yield _fit_with(score, swapped.members, second, swapped)
    dof = score.design.dof
    for first, second in combinations(fitted.members, 2):
        rows = [set(g.effect.rows(g.joints, dof)) for g in (first, second)]
        if rows[0] & rows[1]:
            others = tuple(g for g in fitted.members if g not in (first, second))
            without = score.fit_like(others, fitted)
            for candidate in _additions(search, without, (first, second))[:FIRST]:
                yield _fit_with(score, others, candidate, without)


def _additions(
    search: Search,
    base: Fit,
    gone: Sequence[CandidateColumns],
    instead: CandidateColumns | None = None,
) -> list[CandidateColumns]:
    """Single additional candidates other than those removed, likeliest first."""
    keys = {g.key for g in gone}
    listed = search.shortlist(base, instead, LOOKS)
    return [g for g in listed if not (g.parts or is_curve(g) or g.key in keys)]


def _fit_with(
    score: Score, others: Sequence[CandidateColumns], candidate: CandidateColumns, like: Fit
) -> Fit:
    members = refine_last_shape(score, (*others, candidate), like)
    return score.fit_like(members, like)


def _body_twins(search: Search, fitted: Fit) -> list[RivalSet]:
    """Sets with one more changed body, which the named ones absorb.

    A smaller load plus a heavier link equals a load; only the price of one more name
    decides.
    """
    bodies = [g for g in fitted.members if g.effect.portable.bodies is not None]
    taken = places_of(fitted.members)
    candidates = [
        g
        for g in search.candidates.groups
        if g.effect.portable.bodies is not None
        and not g.parts
        and (g.effect.name, g.joints) not in taken
        and len(g.ids) == 1
    ]
    if not bodies or not candidates:
        return []
    others = [g for g in fitted.members if g not in bodies]
    before = _information(search.score, fitted, others, candidates)
    after = _information(search.score, fitted, fitted.members, candidates)
    out = []
    for candidate, clear, left in zip(candidates, before, after, strict=True):
        cost = search.cost(candidate) + search.least
        # Evident without the named bodies, which absorb it.
        seen = 0.5 * THRESHOLDS.body_change_share**2 * clear > cost
        if seen and left < THRESHOLDS.absorbed_share * clear:
            out.append(RivalSet((*fitted.members, candidate), -cost, twin=True))
    return out


def _information(
    score: Score,
    fitted: Fit,
    members: Sequence[CandidateColumns],
    candidates: Sequence[CandidateColumns],
) -> Array:
    """Information on each candidate beyond a set. Shape (g,)."""
    design = score.design
    weight = fitted.weight
    system = FitEquations.of(design, score.prior, members)
    half = project_columns(design, system, weight)
    out = np.empty(len(candidates))
    for stack in stack_groups(design, candidates):
        out[stack.members] = stack.beyond(weight, half)[:, 0, 0]
    return out
