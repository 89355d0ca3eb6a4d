"""From a diagnosis to the question that it leaves open."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from residual.diagnosis.causes.sets import near_sets
from residual.diagnosis.examine import Examined
from residual.diagnosis.findings import Named, public_joints
from residual.diagnosis.gate import CLASS, alternatives
from residual.diagnosis.result import Place
from residual.diagnosis.task import Task
from residual.evidence.design import Group
from residual.evidence.fit import Fit, System
from residual.evidence.screen import screen
from residual.evidence.states import as_model, physical
from residual.planning.question import (
    NOTHING,
    TOGETHER,
    Contest,
    Question,
    Rival,
    Signals,
)
from residual.recording import Array

Groups = tuple[Group, ...]


@dataclass(frozen=True, eq=False, slots=True)
class Swap:
    """Some of the named effects, and what could stand in their place.

    Attributes:
        gone: The named ones.
        instead: What stands in their place; an empty one for nothing.
    """

    gone: Groups
    instead: tuple[Groups, ...]


def swaps(
    task: Task, fitted: Fit, told: Sequence[tuple[Group, Sequence[Group], int]]
) -> list[Swap]:
    """Return what other sets within 6 nats differ by, each difference once.

    Args:
        told: Named effects with their equivalents, which are no news here.
    """
    known = {(group.key, other.key) for group, near, _ in told for other in near}
    found: dict[tuple, tuple[Groups, list[Groups]]] = {}
    for one in near_sets(task, fitted):
        gone = _without(fitted.members, one.members)
        instead = _without(one.members, fitted.members)
        pair = tuple(g.key for g in (*gone, *instead))
        if not gone or (len(gone) == len(instead) == 1 and pair in known):
            continue
        key = tuple(g.key for g in gone)
        found.setdefault(key, (gone, []))[1].append(instead)
    return [Swap(gone, tuple(instead)) for gone, instead in found.values()]


def _without(members: Sequence[Group], others: Sequence[Group]) -> Groups:
    keys = {g.key for g in others}
    return tuple(g for g in members if g.key not in keys)


CANDIDATES = 3  # of a joint that keeps more than noise: how many are looked at
PAUSE = 10.0  # s between the logs so far and the next


@dataclass(frozen=True, eq=False, slots=True)
class Basis:
    """The shared columns of all rivals: numbers in a design, in their order.

    Attributes:
        examined: The diagnosis.
        fitted: The fit with all that it names.
        groups: Groups of columns after those of the nominal model.
        place: Where a design's column stands among the shared ones.
    """

    examined: Examined
    fitted: Fit
    groups: tuple[Group, ...]
    place: dict[int, int]

    @classmethod
    def of(cls, examined: Examined, fitted: Fit, groups: Sequence[Group]) -> "Basis":
        """Number the columns of the nominal model, then those of the groups."""
        unique: dict[int, Group] = {int(g.ids[0]): g for g in groups}
        ids = [examined.task.design.nominal, *(g.ids for g in unique.values())]
        place = {int(c): i for i, c in enumerate(np.concatenate(ids))}
        return cls(examined, fitted, tuple(unique.values()), place)

    @property
    def task(self) -> Task:
        """Data, prior and candidates."""
        return self.examined.task

    @property
    def weight(self) -> Array:
        """Information of a unit of squared error [1 / N^2 m^2]. Shape (dof,)."""
        return self.fitted.weight(self.task.design.rows)

    def rival(
        self, members: Sequence[Group], own: Sequence[Group], joint: int, without: Fit
    ) -> Rival:
        """Return what is known of one set of effects.

        Args:
            own: Those that make the difference; empty for none.
        """
        design, weight = self.task.design, self.weight
        system = System.of(design, self.task.prior, members)
        theta, _ = system.solve(weight)
        total = np.tensordot(weight, system.gram, 1)
        nats, at = 0.0, np.zeros(0, dtype=int)
        if own:
            big = self.task.fit(members, self.fitted)
            # Every name after the first has to pass the threshold of a name, too.
            more = (len(own) - 1) * self.task.rules.threshold
            cost = sum(self.task.candidates.cost(g) for g in own[1:]) + more
            nats = self.task.net_gain(big, without, own[0]) - cost
            at = np.array([self.place[int(c)] for g in own for c in g.ids])
        base = System.of(design, self.task.prior, without.members)
        fall = base.squared_error(base.solve(weight)[0]) - system.squared_error(theta)
        return Rival(
            _place(own),
            np.array([self.place[int(c)] for c in system.ids]),
            at,
            theta,
            system.precision + total,
            float(nats),
            float(0.5 * weight[joint] * fall[joint]),
        )

    def contest(
        self,
        rest: Sequence[Group],
        options: Sequence[Group],
        joint: int,
        nothing: bool = False,
    ) -> Contest:
        """Return the contest of some candidates beside a set of other effects.

        Args:
            joint: Where they matter most, from 0.
            nothing: Whether there may be none of them.
        """
        without = self.task.fit(rest, self.fitted)
        none = self.rival(rest, (), joint, without)
        found = [self.rival((*rest, g), (g,), joint, without) for g in options]
        families = [g.effect.family for g in options]
        kin = {
            (a, b)
            for a, x in enumerate(families)
            for b, y in enumerate(families)
            if a != b and x and x == y
        }
        rivals = (*found, none) if nothing else tuple(found)
        enough = self.task.rules.threshold if nothing else CLASS
        return Contest(rivals, enough, joint, frozenset(kin), none)


def open_question(examined: Examined, fitted: Fit, named: Sequence[Named]) -> Question:
    """Return what a diagnosis leaves open.

    A finding with equivalents is a contest between it and them, and so are some of the
    findings with what could stand in their place together. Where nothing is named and
    a joint keeps more than noise, the strongest candidates there are rivals of one
    another and of nothing, although none of them could be named.
    """
    wanted = [
        (t.group, near, t.joint)
        for finding in named
        if finding.equivalent
        for t in finding.tested
        if (near := alternatives(examined.task, fitted, t.group)[0])
    ]
    doubted = () if named else examined.adequacy.doubted
    strong = [(j, _strongest(examined, fitted, j)) for j in doubted]
    swapped = swaps(examined.task, fitted, wanted)
    every = [g for _, near, _ in wanted for g in near]
    every += [g for _, groups in strong for g in groups]
    every += [g for swap in swapped for own in swap.instead for g in own]
    basis = Basis.of(examined, fitted, [*fitted.members, *every])
    contests = [
        basis.contest(
            [g for g in fitted.members if g is not group], [group, *near], joint
        )
        for group, near, joint in wanted
    ]
    contests += [
        basis.contest(fitted.members, groups, j, nothing=True)
        for j, groups in strong
        if groups
    ]
    seen = {t.group: t.joint for finding in named for t in finding.tested}
    contests += [_of_sets(basis, swap, seen) for swap in swapped]
    return question_of(basis, contests)


def _of_sets(basis: Basis, swap: Swap, seen: Mapping[Group, int]) -> Contest:
    """The contest of some of the named effects with others in their place."""
    gone = swap.gone
    rest = [g for g in basis.fitted.members if g not in gone]
    joint = next((seen[g] for g in gone if g in seen), 0)
    without = basis.task.fit(rest, basis.fitted)
    found = [
        basis.rival((*rest, *own), own, joint, without) for own in (gone, *swap.instead)
    ]
    none = basis.rival(rest, (), joint, without)
    return Contest(tuple(found), CLASS, joint, frozenset(), none)


def _place(own: Sequence[Group]) -> Place:
    """The name of a rival: that of its effect, or of several together."""
    if not own:
        return NOTHING
    joints = sorted({j for g in own for j in public_joints(g)})
    return Place(TOGETHER.join(g.effect.name for g in own), tuple(joints))


def question_of(basis: Basis, contests: Sequence[Contest]) -> Question:
    """Return contests with all that it takes to look at a motion."""
    examined, model = basis.examined, basis.examined.nominal.model
    terms = [(t.effect, t.joints, t.shape) for t in model.terms]
    groups = [(g.effect, g.joints, g.shape) for g in basis.groups]
    return Question(
        nominal=model,
        seen_with=physical(as_model(examined.nominal, basis.fitted)),
        effects=(*terms, *groups),
        signals=_signals(basis),
        contests=tuple(contests),
    )


def _signals(basis: Basis) -> Signals:
    logs, filters = basis.examined.logs, basis.examined.logs.filters
    tracks = logs.tracks
    cutoff = min(t.cutoff for t in tracks)
    last = max(t.t[-1] for t in tracks)
    return Signals(
        information=basis.weight,
        speed_floor=logs.speed_floor,
        rate=float(np.median([t.rate / t.step for t in tracks])),
        margin=filters.margin / cutoff,
        edge=filters.edge,
        start=0.0 if logs.clock is None else float(last - logs.clock + PAUSE),
    )


def _strongest(examined: Examined, fitted: Fit, joint: int) -> list[Group]:
    """The candidates with the most evidence on a joint, one shape of each.

    None that has no evidence beyond its price: where nothing speaks for a candidate, no
    motion could choose among them.
    """
    task = examined.task
    dof = task.design.dof
    groups = [
        g
        for g in task.candidates.groups
        if not g.parts and joint in g.effect.rows(g.joints, dof)
    ]
    price = np.array([task.candidates.cost(g) for g in groups])
    own = System.of(task.design, task.prior, fitted.members)
    net = screen(task.design, fitted, groups, own) - price
    chosen: dict[tuple, Group] = {}
    known = {g.key for g in fitted.members}
    for i in np.argsort(-net):
        if net[i] <= 0 or len(chosen) == CANDIDATES:
            break
        if groups[i].key not in known:
            chosen.setdefault(groups[i].key, groups[i])
    return list(chosen.values())
