"""The open question after some logs: rival models, and their posteriors."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.diagnosis.findings import NamedEffect, joint_numbers
from residual.diagnosis.outcome import Outcome
from residual.diagnosis.rivals import RivalSet
from residual.diagnosis.search import Search
from residual.effects.base import PlacedEffect
from residual.evidence.design import CandidateColumns
from residual.evidence.fit import Fit, FitEquations, build_fitted_model, keep_physical_terms
from residual.evidence.priors import screen_candidates
from residual.evidence.thresholds import THRESHOLDS
from residual.planning.next_experiment import (
    OpenQuestion,
    Rival,
    RivalContest,
    SignalSettings,
    merge_places,
)
from residual.recording import Array
from residual.verdict.result import Place

CANDIDATES = 3  # candidates considered on a joint with a residual above noise
PAUSE = 10.0  # s between the logs so far and the next

Groups = tuple[CandidateColumns, ...]


@dataclass(frozen=True, eq=False, slots=True)
class MemberSwap:
    """Some of the named effects, and their possible replacement.

    Attributes:
        gone: The named ones.
        instead: Their replacement; empty for nothing.
    """

    gone: Groups
    instead: tuple[Groups, ...]


def find_member_swaps(
    fitted: Fit,
    named: Sequence[tuple[CandidateColumns, Sequence[CandidateColumns]]],
    rivals: Sequence[RivalSet],
) -> list[MemberSwap]:
    """Return the differences of other sets that a motion may separate, each once.

    Args:
        named: Named effects with their equivalents, which are skipped.
        rivals: The other sets within 6 nats.
    """
    known = {(group.key, other.key) for group, near in named for other in near}
    found: dict[tuple, tuple[Groups, list[Groups]]] = {}
    for one in (rival for rival in rivals if not rival.twin):
        gone = _without(fitted.members, one.members)
        instead = _without(one.members, fitted.members)
        pair = tuple(g.key for g in (*gone, *instead))
        if not gone or (len(gone) == len(instead) == 1 and pair in known):
            continue
        key = tuple(g.key for g in gone)
        found.setdefault(key, (gone, []))[1].append(instead)
    return [MemberSwap(gone, tuple(instead)) for gone, instead in found.values()]


def _without(members: Sequence[CandidateColumns], removed: Sequence[CandidateColumns]) -> Groups:
    keys = {g.key for g in removed}
    return tuple(g for g in members if g.key not in keys)


@dataclass(frozen=True, eq=False, slots=True)
class SharedColumns:
    """The shared columns of all rivals: numbers in a design, in their order.

    Attributes:
        outcome: The diagnosis.
        fitted: The fit with all that it names.
        groups: Groups of columns after those of the nominal model.
        place: Position of a design's column among the shared ones.
    """

    outcome: Outcome
    fitted: Fit
    groups: tuple[CandidateColumns, ...]
    place: dict[int, int]

    @classmethod
    def of(
        cls, outcome: Outcome, fitted: Fit, groups: Sequence[CandidateColumns]
    ) -> "SharedColumns":
        """Number the columns of the nominal model, then those of the groups."""
        unique: dict[int, CandidateColumns] = {int(g.ids[0]): g for g in groups}
        ids = [outcome.design.nominal, *(g.ids for g in unique.values())]
        place = {int(c): i for i, c in enumerate(np.concatenate(ids))}
        return cls(outcome, fitted, tuple(unique.values()), place)

    @property
    def search(self) -> Search:
        """Data, prior and candidates."""
        return self.outcome.selection.search

    @property
    def weight(self) -> Array:
        """Information of a unit of squared error [1 / N^2 m^2]. Shape (dof,)."""
        return self.fitted.weight

    def rival(
        self,
        members: Sequence[CandidateColumns],
        deciding: Sequence[CandidateColumns],
        without: Fit,
    ) -> Rival:
        """Return the posterior of one set of effects.

        Args:
            deciding: The effects that differ; empty for none.
            without: The fit without them.
        """
        system = FitEquations.of(self.outcome.design, self.outcome.prior, members)
        theta, _ = system.solve(self.weight)
        nats, at = 0.0, np.zeros(0, dtype=int)
        if deciding:
            big = self.outcome.score.fit_like(members, self.fitted)
            # Every name after the first has to pass the threshold of a name too.
            more = (len(deciding) - 1) * self.search.least
            cost = sum(self.search.cost(g) for g in deciding) + more
            nats = big.score - without.score - cost
            at = np.array([self.place[int(c)] for g in deciding for c in g.ids])
        return Rival(
            merge_places(list_places(deciding)),
            np.array([self.place[int(c)] for c in system.ids]),
            at,
            theta,
            system.precision + np.tensordot(self.weight, system.gram, 1),
            float(nats),
        )

    def contest(
        self, shared: Sequence[CandidateColumns], options: Sequence[Groups], enough: float
    ) -> RivalContest:
        """Return the contest of some sets, with a set of other effects in common.

        Args:
            options: The sets; an empty one for nothing.
            enough: Nats by which one must lead.
        """
        without = self.outcome.score.fit_like(shared, self.fitted)
        found = [self.rival((*shared, *own), own, without) for own in options]
        return RivalContest(tuple(found), enough)


def build_open_question(
    outcome: Outcome, fitted: Fit, named: Sequence[NamedEffect], rivals: Sequence[RivalSet]
) -> OpenQuestion:
    """Return the open question of a diagnosis.

    A finding, its equivalents and its replacements are one contest, and so are several
    findings with their replacements. If nothing is named and a joint has a residual
    above noise, its strongest candidates are rivals of each other and of nothing,
    although none of them could be named.

    Args:
        rivals: Sets that the logs cannot separate from the named one.
    """
    equal = [(t.group, t.equivalent) for finding in named for t in finding.tested if t.equivalent]
    classes: dict[tuple, MemberSwap] = {
        (group.key,): MemberSwap((group,), tuple((g,) for g in near)) for group, near in equal
    }
    for swap in find_member_swaps(fitted, equal, rivals):
        key = tuple(g.key for g in swap.gone)
        known = classes.get(key, MemberSwap(swap.gone, ()))
        classes[key] = replace(known, instead=(*known.instead, *swap.instead))
    doubted = () if named else outcome.adequacy.doubted
    strong = [found for j in doubted if (found := _strongest(outcome, fitted, j))]
    every = [g for s in classes.values() for own in s.instead for g in own]
    every += [g for groups in strong for g in groups]
    basis = SharedColumns.of(outcome, fitted, [*fitted.members, *every])
    contests = [
        basis.contest(
            [g for g in fitted.members if g not in swap.gone],
            (swap.gone, *swap.instead),
            THRESHOLDS.class_nats,
        )
        for swap in classes.values()
    ]
    threshold = THRESHOLDS.named_nats
    contests += [
        basis.contest(fitted.members, [*((g,) for g in groups), ()], threshold) for groups in strong
    ]
    return build_question(basis, contests)


def list_places(groups: Sequence[CandidateColumns]) -> list[Place]:
    """Return the places of some groups of columns."""
    return [Place(g.effect.name, joint_numbers(g)) for g in groups]


def build_question(basis: SharedColumns, contests: Sequence[RivalContest]) -> OpenQuestion:
    """Return contests with the data for evaluating a motion."""
    outcome, model = basis.outcome, basis.outcome.nominal.model
    terms = [PlacedEffect(t.effect, t.joints, t.shape) for t in model.terms]
    groups = [g.placed for g in basis.groups]
    return OpenQuestion(
        nominal=model,
        seen_with=keep_physical_terms(build_fitted_model(outcome.nominal, basis.fitted)),
        effects=(*terms, *groups),
        signals=_signals(basis),
        contests=tuple(c for c in contests if all(map(_has_spread, c.rivals))),
    )


def _has_spread(rival: Rival) -> bool:
    """Whether the precision of a rival can be inverted in double precision.

    With logs that do not fit the description it may not: then the value of another log
    cannot be computed.
    """
    scale = 1 / np.sqrt(np.diag(rival.precision))
    scaled = rival.precision * np.outer(scale, scale)
    least = len(scale) * np.finfo(float).eps
    return bool(np.linalg.eigvalsh(scaled)[0] > least)


def _signals(basis: SharedColumns) -> SignalSettings:
    logs, filters = basis.outcome.logs, basis.outcome.logs.filters
    tracks = logs.tracks
    cutoff = min(t.cutoff for t in tracks)
    last = max(t.t[-1] for t in tracks)
    return SignalSettings(
        information=basis.weight,
        speed_floor=logs.speed_floor,
        rate=float(np.median([t.rate / t.step for t in tracks])),
        margin=filters.margin / cutoff,
        edge=filters.edge,
        start=0.0 if logs.clock is None else float(last - logs.clock + PAUSE),
    )


def _strongest(outcome: Outcome, fitted: Fit, joint: int) -> list[CandidateColumns]:
    """The candidates with the most evidence on a joint, one shape of each.

    Only those with evidence beyond their price: no motion could choose among others.
    """
    search, design, dof = outcome.selection.search, outcome.design, outcome.design.dof
    groups = [
        g for g in search.candidates.groups if not g.parts and joint in g.effect.rows(g.joints, dof)
    ]
    price = np.array([search.cost(g) for g in groups])
    own = FitEquations.of(design, outcome.prior, fitted.members)
    net = screen_candidates(design, fitted, groups, own) - price
    chosen: dict[tuple, CandidateColumns] = {}
    known = {g.key for g in fitted.members}
    for i in np.argsort(-net):
        if net[i] <= 0 or len(chosen) == CANDIDATES:
            break
        if groups[i].key not in known:
            chosen.setdefault(groups[i].key, groups[i])
    return list(chosen.values())
