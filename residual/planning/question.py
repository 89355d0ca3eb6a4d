"""What is left open after some logs: rival models, and what is known of each."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np

from residual.diagnosis.examine import Examined
from residual.diagnosis.findings import Named, public_joints
from residual.diagnosis.neighbours import alternatives, near_sets
from residual.diagnosis.result import Place
from residual.diagnosis.search import Task
from residual.effects.base import Placed
from residual.evidence.design import Group
from residual.evidence.fit import Fit, System, as_model, physical
from residual.evidence.priors import screen
from residual.evidence.rules import RULES
from residual.model.model import Model
from residual.recording import Array

NOTHING = Place("nothing", ())
TOGETHER = " + "  # between the names of a rival of several effects
CANDIDATES = 3  # of a joint that keeps more than noise: how many are looked at
PAUSE = 10.0  # s between the logs so far and the next

Groups = tuple[Group, ...]


@dataclass(frozen=True, eq=False, slots=True)
class Rival:
    """One model that may be true, as a Gaussian over coefficients of shared columns."""

    place: Place  # the effect that makes the difference, `NOTHING` for none
    columns: Array  # which of the shared columns it has, (k,)
    own: Array  # which of these are the effect's own; empty for none, (e,)
    mean: Array  # their posterior mean [SI], (k,)
    precision: Array  # their posterior precision, (k, k)
    # Evidence of the logs so far, less the price of the name [nats], up to a constant
    # that is the same for all rivals of a contest.
    nats: float


@dataclass(frozen=True, eq=False, slots=True)
class Contest:
    """Models of which one is true."""

    rivals: tuple[Rival, ...]  # two or more
    enough: float  # nats by which one must lead to be believed

    @property
    def pairs(self) -> tuple[tuple[int, int], ...]:
        """Every ordered pair of rivals: the true one first."""
        return tuple(permutations(range(len(self.rivals)), 2))

    def lead(self, a: int, b: int) -> float:
        """By how much the logs so far prefer one rival to another [nats]."""
        return self.rivals[a].nats - self.rivals[b].nats


@dataclass(frozen=True, eq=False, slots=True)
class Signals:
    """How the logs so far were read, and so will the next one be."""

    information: Array  # of a row's squared error [1 / N^2 m^2], (dof,)
    speed_floor: Array  # speed under which a joint stands [rad/s], (dof,)
    rate: float  # rows per second [Hz]
    margin: float  # time about a standstill that does not count [s]
    edge: float  # time at both ends of a log that does not count [s]
    start: float  # session time at which the next log may begin [s]


@dataclass(frozen=True, eq=False, slots=True)
class Question:
    """What the logs so far leave open."""

    nominal: Model  # the model that deviations are counted from
    seen_with: Model  # the model whose torque the effects see
    effects: tuple[Placed, ...]  # columns after the inertial ones
    signals: Signals
    contests: tuple[Contest, ...]  # empty if nothing is open


@dataclass(frozen=True, eq=False, slots=True)
class Swap:
    """Some of the named effects, and what could stand in their place."""

    gone: Groups  # the named ones
    instead: tuple[Groups, ...]  # an empty one for nothing


def swaps(
    task: Task, fitted: Fit, named: Sequence[tuple[Group, Sequence[Group]]]
) -> list[Swap]:
    """Return what other sets within 6 nats differ by, each difference once.

    The equivalents of the named effects are no news here.
    """
    known = {(group.key, other.key) for group, near in named for other in near}
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


@dataclass(frozen=True, eq=False, slots=True)
class Basis:
    """The shared columns of all rivals: numbers in a design, in their order."""

    examined: Examined
    fitted: Fit  # with all that is named
    groups: tuple[Group, ...]  # columns after those of the nominal model
    place: dict[int, int]  # where a design's column stands among the shared ones

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
        self, members: Sequence[Group], own: Sequence[Group], without: Fit
    ) -> Rival:
        """Return what is known of a set of effects, those of its own among them."""
        system = System.of(self.task.design, self.task.prior, members)
        theta, _ = system.solve(self.weight)
        nats, at = 0.0, np.zeros(0, dtype=int)
        if own:
            big = self.task.fit(members, self.fitted)
            # Every name after the first has to pass the threshold of a name, too.
            more = (len(own) - 1) * self.task.rules.threshold
            cost = sum(self.task.candidates.cost(g) for g in own[1:]) + more
            nats = self.task.net_gain(big, without, own[0]) - cost
            at = np.array([self.place[int(c)] for g in own for c in g.ids])
        return Rival(
            together(places_of(own)),
            np.array([self.place[int(c)] for c in system.ids]),
            at,
            theta,
            system.precision + np.tensordot(self.weight, system.gram, 1),
            float(nats),
        )

    def contest(
        self, rest: Sequence[Group], options: Sequence[Groups], enough: float
    ) -> Contest:
        """Return the contest of some sets, an empty one for nothing, beside others."""
        without = self.task.fit(rest, self.fitted)
        found = [self.rival((*rest, *own), own, without) for own in options]
        return Contest(tuple(found), enough)


def open_question(examined: Examined, fitted: Fit, named: Sequence[Named]) -> Question:
    """Return what a diagnosis leaves open.

    A finding, its equivalents and what could stand in its place together are one
    contest, and so are several findings and what could stand in theirs. Where nothing
    is named and a joint keeps more than noise, the strongest candidates there are
    rivals of one another and of nothing, although none of them could be named.
    """
    equal = [
        (t.group, near)
        for finding in named
        if finding.equivalent
        for t in finding.tested
        if (near := alternatives(examined.task, fitted, t.group)[0])
    ]
    classes: dict[tuple, Swap] = {
        (group.key,): Swap((group,), tuple((g,) for g in near)) for group, near in equal
    }
    for swap in swaps(examined.task, fitted, equal):
        key = tuple(g.key for g in swap.gone)
        known = classes.get(key, Swap(swap.gone, ()))
        classes[key] = replace(known, instead=(*known.instead, *swap.instead))
    doubted = () if named else examined.adequacy.doubted
    strong = [found for j in doubted if (found := _strongest(examined, fitted, j))]
    every = [g for s in classes.values() for own in s.instead for g in own]
    every += [g for groups in strong for g in groups]
    basis = Basis.of(examined, fitted, [*fitted.members, *every])
    contests = [
        basis.contest(
            [g for g in fitted.members if g not in swap.gone],
            (swap.gone, *swap.instead),
            RULES.class_nats,
        )
        for swap in classes.values()
    ]
    threshold = examined.task.rules.threshold
    contests += [
        basis.contest(fitted.members, [*((g,) for g in groups), ()], threshold)
        for groups in strong
    ]
    return question_of(basis, contests)


def together(places: Sequence[Place]) -> Place:
    """The name of a rival: that of its effect, or of several together."""
    if not places:
        return NOTHING
    joints = sorted({j for place in places for j in place.joints})
    return Place(TOGETHER.join(place.name for place in places), tuple(joints))


def places_of(groups: Sequence[Group]) -> list[Place]:
    """Return where some groups of columns sit."""
    return [Place(g.effect.name, public_joints(g)) for g in groups]


def question_of(basis: Basis, contests: Sequence[Contest]) -> Question:
    """Return contests with all that it takes to look at a motion."""
    examined, model = basis.examined, basis.examined.nominal.model
    terms = [Placed(t.effect, t.joints, t.shape) for t in model.terms]
    groups = [g.placed for g in basis.groups]
    logs, tracks = examined.logs, examined.logs.tracks
    last = max(t.t[-1] for t in tracks)
    signals = Signals(
        information=basis.weight,
        speed_floor=logs.speed_floor,
        rate=float(np.median([t.rate / t.step for t in tracks])),
        margin=logs.filters.margin / min(t.cutoff for t in tracks),
        edge=logs.filters.edge,
        start=0.0 if logs.clock is None else float(last - logs.clock + PAUSE),
    )
    return Question(
        nominal=model,
        seen_with=physical(as_model(examined.nominal, basis.fitted)),
        effects=(*terms, *groups),
        signals=signals,
        contests=tuple(c for c in contests if all(map(_has_spread, c.rivals))),
    )


def _has_spread(rival: Rival) -> bool:
    """Whether the precision of a rival can be inverted in double precision.

    Of logs that no arm of that description gives it may not: then what another log of
    it would bring cannot be computed, and nothing is promised.
    """
    scale = 1 / np.sqrt(np.diag(rival.precision))
    scaled = rival.precision * np.outer(scale, scale)
    least = len(scale) * np.finfo(float).eps
    return bool(np.linalg.eigvalsh(scaled)[0] > least)


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
