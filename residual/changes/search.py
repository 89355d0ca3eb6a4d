"""Which effects changed: the best name that the logs cannot do without, and others."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.changes.contrast import (
    ChangeCandidate,
    ChangeEstimate,
    ChangeRegression,
    build_change_candidates,
    build_change_groups,
    recompute_groups,
    shift_candidate_shape,
)
from residual.changes.nuisance import (
    FrictionDrift,
    is_single_column_group,
    measure_noise,
    project_out_nuisance,
    select_basic_groups,
)
from residual.changes.rows import EpochRows, JointRows, account_for_changes
from residual.effects.base import EffectTrait, against_position
from residual.evidence.fit import find_group_limits
from residual.recording import Array
from residual.verdict.result import Place

WIDTHS = (1.0, 0.4, 0.15)  # of the reach of an effect: how far a shape is refined
LEAST, MANY = -3.0, 16  # candidates that get a look at their blocks [nats]
NEAR = 0.6  # of the best evidence: what a shape that is not refined may reach
APART = 0.02  # of a candidate that those that are named do not have
LOOKS = 3  # candidates with a shape that are refined before one is chosen


@dataclass(frozen=True, eq=False, slots=True)
class NamedChange:
    """One change that is named.

    Attributes:
        contrast: What is known of it, beside the others.
        share: Its torque in the second epoch, as a share of that of the joint on which
            it is largest.
        joint: That joint, from 0.
        equivalent: What these logs do not tell from it.
        probability: Of its class against all other names.
    """

    contrast: ChangeEstimate
    share: float
    joint: int
    equivalent: tuple[ChangeCandidate, ...]
    probability: float

    @property
    def place(self) -> Place:
        """The effect, and its joints from 1."""
        return self.contrast.candidate.place


@dataclass(frozen=True, eq=False, slots=True)
class ChangeSearch:
    """What the rows of both epochs say."""

    both: EpochRows  # the rows
    table: ChangeRegression  # the joints and their noise, beside what was found
    every: tuple[ChangeCandidate, ...]  # all candidates
    changes: tuple[NamedChange, ...]  # what is named, most torque first
    warmth: FrictionDrift  # friction of all joints together
    refuted: tuple[NamedChange, ...] = ()  # what held-out logs speak against
    # Bodies that fell, since no body can be what the logs make of them.
    without_body: tuple[NamedChange, ...] = ()

    @property
    def named(self) -> list[ChangeCandidate]:
        """The candidates that are named."""
        return [c.contrast.candidate for c in self.changes]

    def without(self, gone: Sequence[NamedChange]) -> "ChangeSearch":
        """The same without some of the named changes."""
        return replace(self, changes=tuple(c for c in self.changes if c not in gone))

    def share(self, candidate: ChangeCandidate, theta: Array) -> tuple[float, int]:
        """Return the share of torque that a change has, and on which joint."""
        return change_torque_share(self.both, self.table.joints, candidate, theta)


def change_torque_share(
    both: EpochRows,
    joints: Mapping[int, JointRows],
    candidate: ChangeCandidate,
    theta: Array,
) -> tuple[float, int]:
    """Largest torque of a change on the second epoch's rows, of the joint's rms.

    And the joint, from 0.
    """
    largest, at = 0.0, 0
    design = both.design
    for j in candidate.pieces:
        second = joints[j].layout.second
        columns = design.columns(j, design.present(j, candidate.group.ids)[0])[second]
        rms = np.sqrt((design.tau[j][second] ** 2).mean())
        share = float(np.sqrt(((columns @ theta) ** 2).mean())) / max(rms, 1e-9)
        if share > largest:
            largest, at = share, j
    return largest, at


def search_changes(both: EpochRows, clocked: bool) -> ChangeSearch:
    """Search the rows of both epochs for what changed.

    Args:
        clocked: Whether the order of each epoch's logs in time is known.
    """
    groups, prices = build_change_groups(both, clocked)
    nuisance = project_out_nuisance(both, groups)
    noise = measure_noise(both, nuisance, select_basic_groups(groups))
    every = build_change_candidates(both.design, nuisance.joints, groups, prices)
    look = _Searcher(
        both,
        nuisance.joints,
        every,
        ChangeRegression(nuisance.joints, both.blocks, noise),
    )
    # What presses on the gears comes before anything that goes by that.
    named = look.search([], most=1)
    changed, press = _large_changes(look, named)
    if changed:
        # The joint fit, and columns that depend on the torque, see it from here on.
        both = account_for_changes(both, changed, press)
        groups_before = [c.group for c in look.every]
        groups = recompute_groups(both, look.every) if press else groups_before
        prices = [c.price for c in look.every]
        nuisance = project_out_nuisance(both, groups_before)
        noise = measure_noise(both, nuisance, select_basic_groups(groups_before))
        every = build_change_candidates(
            both.design, nuisance.joints, groups, prices, groups_before
        )
        look = _Searcher(
            both,
            nuisance.joints,
            every,
            ChangeRegression(nuisance.joints, both.blocks, noise),
        )
        named = look.same_keys(named)
    named = look.search(named, both.rules.max_changes)
    changes = [look.conclude(c, named) for c in named]
    changes.sort(key=lambda c: -c.share)
    return ChangeSearch(
        both, look.table, tuple(look.every), tuple(changes), nuisance.warmth
    )


def _large_changes(
    look: "_Searcher", named: Sequence[ChangeCandidate]
) -> tuple[list, bool]:
    """Changes that shift the joint fit or the load of the gears."""
    thetas = look.table.theta(named)
    every = [(c.group, theta) for c, theta in zip(named, thetas, strict=True)]
    shares = [
        change_torque_share(look.both, look.joints, c, t)[0]
        for c, t in zip(named, thetas, strict=True)
    ]
    if max(shares, default=0.0) < look.both.rules.large_torque_share:
        return [], False
    return every, any(g.effect.carries == "body" for g, _ in every)


def _formless(named: Sequence[ChangeCandidate]) -> list[ChangeCandidate]:
    """Names that only together draw one curve over the position of a joint.

    A joint that has a spring at once and a balancer has neither: a stop or a cable,
    which has no name here.
    """
    curves: dict[int, list[ChangeCandidate]] = {}
    for c in named:
        effect = c.group.effect
        if effect.variable is against_position and not (
            effect.traits & (EffectTrait.PERIODIC | EffectTrait.FRICTION)
        ):
            curves.setdefault(c.group.joints[0], []).append(c)
    return [c for own in curves.values() if len(own) > 1 for c in own]


class _Searcher:
    """A search under way: the candidates so far, and the noise beside what is named."""

    def __init__(
        self,
        both: EpochRows,
        joints: Mapping[int, JointRows],
        every: Sequence[ChangeCandidate],
        table: ChangeRegression,
    ) -> None:
        self.both, self.joints, self.table = both, joints, table
        self.every = list(every)
        self._start = table.noise
        self._refined: set[ChangeCandidate] = set()

    def search(self, named: list[ChangeCandidate], most: int) -> list[ChangeCandidate]:
        """Add, swap and drop names until nothing is gained."""
        named = self._improve(list(named)) if named else []
        while len(named) < most:
            best = self._next(named)
            if best is None:
                break
            named = self._plainer([*named, best])
            named = self._improve(named) if len(named) > 1 else named
        named = self._prune(named)
        mixed = _formless(named)
        if mixed:
            named = [c for c in named if c not in mixed]
            self.settle(named)
        return named

    def same_keys(self, named: Sequence[ChangeCandidate]) -> list[ChangeCandidate]:
        """The candidates of the same keys, with the likeliest shape."""
        out: list[ChangeCandidate] = []
        for candidate in named:
            shapes = [c for c in self.every if c.key == candidate.key]
            out += [shapes[int(np.argmax(self.table.fits(shapes, out)))]]
        return out

    def settle(self, named: Sequence[ChangeCandidate]) -> None:
        """Size of the errors of every joint beside what is named.

        No smaller than in the first epoch: what is left may be more than noise.
        """
        variance = self._start.variance.copy()
        thetas = self.table.theta(named)
        for j, joint in self.joints.items():
            left = joint.y
            for c, theta in zip(named, thetas, strict=True):
                if j in c.pieces:
                    left = left - c.pieces[j].columns @ theta
            own = left @ left / max(joint.degrees, 1.0)
            variance[j] = max(variance[j], own)
        self.table = self.table.with_noise(replace(self._start, variance=variance))

    def looks(self, named: Sequence[ChangeCandidate]) -> list[ChangeEstimate]:
        """What is known of the likeliest candidates beside others, one of each key."""
        keys = {c.key for c in named}
        others = [c for c in self.every if c.key not in keys]
        fits = self.table.fits(others, named)
        best: dict[tuple, int] = {}
        for i in np.argsort(-fits):
            best.setdefault(others[i].key, int(i))
        indices = [i for i in best.values() if fits[i] > LEAST]
        contrasts = [self.table.contrast(others[i], named) for i in indices[:MANY]]
        return [x for x in contrasts if self._possible(x)]

    def _next(self, named: list[ChangeCandidate]) -> ChangeCandidate | None:
        """The best further candidate; None where no one passes."""
        rules = self.both.rules
        looks = self._with_refined(self.looks(named), named)
        significant = [x for x in looks if x.nats > rules.min_nats]
        if not significant:
            return None
        # Errors are judged beside the likeliest name, then names by the error they
        # leave.
        before = self.table
        first = max(significant, key=lambda x: x.nats)
        self.settle([*named, first.candidate])
        contrasts = [self.table.contrast(x.candidate, named) for x in significant]
        least = self._least(named)
        contrasts = [x for x in contrasts if self.share(x.candidate, x.theta) >= least]
        if not contrasts:
            self.table = before
            return None
        best = self._simplest(contrasts)
        self.settle([*named, best])
        return best

    def _least(self, named: Sequence[ChangeCandidate]) -> float:
        """Least torque share of a further change."""
        pairs = zip(named, self.table.theta(named), strict=True)
        top = max((self.share(c, theta) for c, theta in pairs), default=0.0)
        return max(
            self.both.rules.min_torque_share, self.both.rules.min_share_of_largest * top
        )

    def _simplest(self, looks: Sequence[ChangeEstimate]) -> ChangeCandidate:
        """The simplest of the candidates within the tie of the best."""
        rules, top = self.both.rules, max(x.fit for x in looks)
        # No column is quite what an arm does: the more evidence, the more that counts.
        near = [
            x for x in looks if top - x.fit < rules.tie_nats + rules.crude_share * top
        ]

        def rank(x: ChangeEstimate) -> tuple:
            group = x.candidate.group
            return (
                group.effect.far_fetched > 0,
                len(group.ids) + len(group.shape),
                -x.fit,
            )

        return min(near, key=rank).candidate

    def _with_refined(
        self, looks: list[ChangeEstimate], named: Sequence[ChangeCandidate]
    ) -> list[ChangeEstimate]:
        """Add refined shapes of the best candidates."""
        best: dict[tuple, ChangeEstimate] = {}
        for x in looks:
            if x.candidate.group.effect.refine:
                old = best.get(x.candidate.key)
                if old is None or x.fit > old.fit:
                    best[x.candidate.key] = x
        # Half way between two shapes of the grid most of the power is seen.
        enough = max((NEAR * x.fit for x in looks), default=0.0)
        enough = max(enough, self.both.rules.min_nats)
        wanted = [x for x in best.values() if x.fit > enough]
        out = list(looks)
        for look in sorted(wanted, key=lambda x: -x.fit)[:LOOKS]:
            for width in WIDTHS:
                if look.candidate in self._refined:
                    break
                tried = shift_candidate_shape(
                    self.both, self.joints, look.candidate, width
                )
                self._refined.add(look.candidate)
                self.every += tried
                fresh = [self.table.contrast(c, named) for c in tried]
                fresh = [x for x in fresh if self._possible(x)]
                out += fresh
                look = max([look, *fresh], key=lambda x: x.fit)
                self._refined.discard(look.candidate)
            self._refined.add(look.candidate)
        return out

    def _plainer(self, named: list[ChangeCandidate]) -> list[ChangeCandidate]:
        """The last name as two plain ones of its joint, where they say more.

        More friction is a level and a slope; between the two lies many a curve.
        """
        *others, last = named
        curved = last.group.effect.scope == "local" and last.group.shape
        if len(named) == self.both.rules.max_changes or not curved:
            return named
        plain = [
            c
            for c in self.every
            if c.group.joints == last.group.joints and is_single_column_group(c.group)
        ]
        pair: list[ChangeCandidate] = []
        worth = -float(self.table.fits([last], others)[0])
        for _ in range(2):
            fits = self.table.fits(plain, [*others, *pair])
            pair.append(plain[int(np.argmax(fits))])
            worth += float(fits.max())
        if worth < 0:
            return named
        self.settle([*others, *pair])
        return [*others, *pair]

    def _improve(self, named: list[ChangeCandidate]) -> list[ChangeCandidate]:
        for _ in range(3):
            before = list(named)
            for i, candidate in enumerate(named):
                others = [c for c in named if c is not candidate]
                looks = self._with_refined(self.looks(others), others)
                if looks:
                    named[i] = self._simplest(looks)
            if all(a is b for a, b in zip(before, named, strict=True)):
                break
            self.settle(named)
        return named

    def _prune(self, named: list[ChangeCandidate]) -> list[ChangeCandidate]:
        rules = self.both.rules
        while named:
            looks = [
                self.table.contrast(c, [x for x in named if x is not c]) for c in named
            ]
            weak = min(looks, key=lambda x: x.nats)
            least = self._least(named)
            small = [x for x in looks if self.share(x.candidate, x.theta) < least]
            if weak.nats >= rules.min_nats and not small:
                break
            gone = weak if weak.nats < rules.min_nats else small[0]
            named = [c for c in named if c is not gone.candidate]
            self.settle(named)
        return named

    def _possible(self, look: ChangeEstimate) -> bool:
        """Whether an arm can have changed so, beside what is named.

        Of what any arm has a little of there may be more or less than before: how much
        there is, in a nuisance of many columns, no one of them says.
        """
        group, both = look.candidate.group, self.both
        if look.apart < APART:
            return False
        limits = find_group_limits(both.design, both.fitted, group)
        thetas = [look.theta]
        if group.effect.scope == "flange":  # a load may go as well as come
            thetas.append(-look.theta)
        anchor = group.joints[0] if group.joints else 0
        if group.effect.in_any_arm(both.logs.span, anchor):
            limits = replace(
                limits, nominal_coefficients=np.zeros_like(limits.nominal_coefficients)
            )
            thetas.append(-look.theta)
        return any(group.effect.possible(x, group.shape, limits) for x in thetas)

    def share(self, candidate: ChangeCandidate, theta: Array) -> float:
        """Largest torque of a change, as a share of the joint's."""
        return change_torque_share(self.both, self.joints, candidate, theta)[0]

    def conclude(
        self, change_candidate: ChangeCandidate, named: Sequence[ChangeCandidate]
    ) -> NamedChange:
        """What is to be said of one name, beside the others."""
        others = [c for c in named if c is not change_candidate]
        mine = self.table.contrast(change_candidate, others)
        best = {change_candidate.key: mine}
        for x in self.looks(others):
            old = best.get(x.candidate.key)
            if old is None or (
                x.fit > old.fit and x.candidate.key != change_candidate.key
            ):
                best[x.candidate.key] = x
        near = self.both.rules.equivalent_nats
        members = {
            k
            for k, x in best.items()
            if k == change_candidate.key or mine.fit - x.fit < near
        }
        top = max(x.fit for x in best.values())
        odds = {k: float(np.exp(x.fit - top)) for k, x in best.items()}
        share, joint = change_torque_share(
            self.both, self.joints, change_candidate, mine.theta
        )
        return NamedChange(
            contrast=mine,
            share=share,
            joint=joint,
            equivalent=tuple(
                best[k].candidate for k in members if k != change_candidate.key
            ),
            probability=sum(odds[k] for k in members) / sum(odds.values()),
        )
