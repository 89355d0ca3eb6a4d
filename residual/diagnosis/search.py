"""Search for the effects that blocks of the logs support: add, swap, drop.

A candidate joins the set if its evidence by blocks (``score``) less the price of the
choice, ln K for one of K candidates and ln V for one of V shapes, makes a false name in
the diagnosis less likely than ``false_chance``, and if left-out blocks or the given
values support it. Free curves over the joint's position and speed are candidates too: if
the residual of one is a quarter smaller than that of any name, the joint gets no name.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from residual.diagnosis.candidates import Candidates
from residual.diagnosis.score import LeftOut, Score, compute_scatter, is_alike
from residual.effects.base import (
    Effect,
    EffectTrait,
    PlacedEffect,
    against_position,
    build_joint_columns,
)
from residual.evidence.columns import CandidateColumns
from residual.evidence.design import Design
from residual.evidence.fit import Fit, FitEquations, fit_jointly, is_fit_possible
from residual.evidence.priors import screen_candidates
from residual.evidence.thresholds import THRESHOLDS
from residual.recording import Array
from residual.signals.track import Track

Members = tuple[CandidateColumns, ...]


def _build_curve(name: str, signal: str) -> Effect:
    """A free curve over a signal of the joint.

    Its shape has the two ends and the offset of each hat: its mean on the logs, or zero.
    """

    def hats(state, joint: int, shape: tuple[float, ...]) -> list[Array]:
        return list(
            _hats(getattr(state, signal)[:, joint], shape[:2]).T - np.array(shape[2:])[:, None]
        )

    return Effect(name, "", {}, build_joint_columns(hats))


def _hats(values: Array, ends: tuple[float, ...]) -> Array:
    """Piecewise linear functions at evenly spaced knots. Shape (n, knots)."""
    knots = np.linspace(*ends, THRESHOLDS.curve_knots)
    x = np.clip(values, *ends)[:, None]
    return np.maximum(1 - abs(x - knots) / (knots[1] - knots[0]), 0)


CURVES = {"q": _build_curve("curve over q", "q"), "qd": _build_curve("curve over qd", "qd")}
CURVE_RIVALS = 3  # names of its joint that are tried next to a curve
ENDS = 1e-3  # quantiles of a signal at the ends of its curve


def is_curve(group: CandidateColumns) -> bool:
    """Whether a group is a free curve, which has no name."""
    return group.effect in CURVES.values()


def add_curves(design: Design, tracks: Sequence[Track], centred: bool) -> list[CandidateColumns]:
    """Append the free curves of each joint that moves.

    Args:
        centred: Whether the model already has the mean of a curve, as a constant.
    """
    placed = []
    moving = np.concatenate([track.moving for track in tracks])
    for signal, effect in CURVES.items():
        values = np.concatenate([getattr(track, signal)[:: track.step] for track in tracks])
        for j in range(design.dof):
            own = values[moving[:, j], j]
            if design.rows[j] < THRESHOLDS.min_rows or np.ptp(own) == 0:
                continue
            ends = tuple(np.quantile(own, (ENDS, 1 - ENDS)).tolist())
            means = tuple((centred * _hats(own, ends).mean(axis=0)).tolist())
            placed.append(PlacedEffect(effect, (j,), (*ends, *means)))
    return design.add(placed)


@dataclass(frozen=True, eq=False, slots=True)
class SearchRun:
    """The result of a search under one prior."""

    score: Score
    fit: Fit
    left_out: LeftOut

    @property
    def named(self) -> Members:
        """Its members except curves."""
        return tuple(g for g in self.fit.members if not is_curve(g))

    @property
    def curves(self) -> Members:
        """Joints that a free curve explains better than any name."""
        return tuple(g for g in self.fit.members if is_curve(g))


@dataclass(frozen=True, eq=False)
class Trial:
    """A set with one more candidate."""

    group: CandidateColumns
    fit: Fit
    nats: float  # its evidence less its price
    score: Score

    @cached_property
    def left_out(self) -> LeftOut:
        """Errors of left-out blocks, computed on demand."""
        return self.score.left_out(self.fit)


@dataclass(frozen=True, eq=False, slots=True)
class Search:
    """Candidates and rivals under one prior."""

    score: Score
    candidates: Candidates
    curves: Sequence[CandidateColumns]

    @property
    def least(self) -> float:
        """Evidence that a name needs beyond its price [nats]."""
        return float(np.log(1 / THRESHOLDS.false_chance))

    def cost(self, group: CandidateColumns) -> float:
        """Price of a group [nats]."""
        if is_curve(group):
            return float(np.log(len(self.candidates.price)))
        return self.candidates.cost(group)

    def set_score(self, fitted: Fit) -> float:
        """Evidence of a set less the price of its names [nats]."""
        return fitted.score - sum(self.cost(g) + self.least for g in fitted.members)

    def leads(self, fitted: Fit, other: Fit) -> bool:
        """Whether a set has more evidence less its price, with the row counts of another."""
        rows = replace(other, counted=np.maximum(fitted.counted, other.counted))
        ours, theirs = (
            self.set_score(self.score.fit_like(f.members, rows)) for f in (fitted, other)
        )
        return ours > theirs

    def run(self, start: Members = ()) -> SearchRun:
        """Add the best candidate while one is supported."""
        fitted = self.score.fit(start)
        fitted = self._drop(fitted) if start else fitted
        left, seen = self.score.left_out(fitted), set()
        # A dropped member may come back: a repeated set ends the search.
        while (places := places_of(fitted.members)) not in seen:
            seen.add(places)
            best = self._choose(self.look(fitted), left)
            if best is None or len(fitted.members) >= THRESHOLDS.max_effects:
                break
            fitted, left = self._join(fitted, best)
        return SearchRun(self.score, fitted, left)

    def select_allowed(self, members: Members) -> Members:
        """Select members of another prior's search that are allowed here."""
        names = {g.effect.name for g in self.candidates.groups}
        return tuple(g for g in members if is_curve(g) or g.effect.name in names)

    def settle(self, members: Members) -> SearchRun:
        """Fit a given set, without members that do not carry their price."""
        fitted = self._drop(self.score.fit(members))
        return SearchRun(self.score, fitted, self.score.left_out(fitted))

    def name_plainly(self, found: SearchRun, group: CandidateColumns) -> SearchRun:
        """Replace names by the plainest ones that blocks cannot separate from them."""
        if _complexity(group) == _PLAIN:
            return found
        rest = tuple(g for g in found.fit.members if g is not group)
        without = self.score.fit(rest, found.fit)
        own = Trial(group, found.fit, self.score.nats(found.fit, group), self.score)
        trials = self.look(without, group, THRESHOLDS.class_looks)
        before = self.score.left_out(without)
        chosen = self._find_simplest(own, found.left_out, trials, before)
        return found if chosen is own else SearchRun(self.score, chosen.fit, chosen.left_out)

    def look(
        self, base: Fit, instead: CandidateColumns | None = None, most: int | None = None
    ) -> list[Trial]:
        """Candidates with enough evidence on top of a fit, most evidence first.

        On a joint with a curve also its likeliest names, however weak.

        Args:
            instead: A removed member, to look for its replacements.
            most: Largest number of fitted candidates.
        """
        most, out, top, looks = most or THRESHOLDS.max_exact_looks, [], 0.0, 0
        curved: dict[tuple[int, ...], int] = {}  # names tried next to a curve
        system = FitEquations.of(self.score.design, self.score.prior, base.members)
        for quick, group in self._rank(base, instead):
            faint = quick < THRESHOLDS.faint_share * top or looks >= most
            if faint and curved.get(group.joints, CURVE_RIVALS) >= CURVE_RIVALS:
                continue
            looks += 1
            parts, own = group.parts or (group,), system
            for part in parts:
                own = own.beside(self.score.design, part)
            fitted = self.score.fit((*base.members, *parts), base, own)
            if not is_fit_possible(self.score.design, fitted, group):
                continue
            nats = self.score.nats(fitted, group) - self.cost(group)
            if nats < self.least:
                continue
            out.append(Trial(group, fitted, nats, self.score))
            if is_curve(group):
                curved.setdefault(group.joints, 0)
            else:
                top = top or quick
                curved |= {j: n + 1 for j, n in curved.items() if j == group.joints}
        return sorted(out, key=lambda trial: -trial.nats)

    def is_borne_out(self, trial: Trial, after: LeftOut, before: LeftOut) -> bool:
        """Whether left-out blocks are predicted better, or parameters stay nearer nominal."""
        if after.gain_over(before).sum() <= -THRESHOLDS.left_out_slack:
            return False
        design, parts = self.score.design, trial.group.parts or (trial.group,)
        shares = [design.torque_shares(g, trial.fit.of(g)).max() for g in parts]
        if design.unrest is None:  # else only noise remains, and every gain counts
            shares.append(after.fall_from(before).max())
        return bool(max(shares) >= THRESHOLDS.min_share)

    def shortlist(
        self, base: Fit, instead: CandidateColumns | None, most: int
    ) -> list[CandidateColumns]:
        """The best shape of the most promising candidates, by quick screening."""
        return [group for _, group in self._rank(base, instead)[:most]]

    def _rank(
        self, base: Fit, instead: CandidateColumns | None
    ) -> list[tuple[float, CandidateColumns]]:
        """Quick evidence less its price of each candidate's best shape, descending."""
        groups = (*self.candidates.groups, *self.curves)
        system = FitEquations.of(self.score.design, self.score.prior, base.members)
        quick = screen_candidates(self.score.design, base, groups, system)
        quick = quick - np.array([self.cost(g) for g in groups])
        chosen: dict[tuple, tuple[float, CandidateColumns]] = {}
        for i in np.argsort(-quick):
            if quick[i] < THRESHOLDS.min_quick_nats:
                break
            if groups[i].key not in chosen and self._fits_in(groups[i], base.members, instead):
                chosen[groups[i].key] = float(quick[i]), groups[i]
        return list(chosen.values())

    def _fits_in(
        self, group: CandidateColumns, members: Members, instead: CandidateColumns | None
    ) -> bool:
        """Whether a candidate may join some members, in place of another."""
        taken = {g.key for g in members if EffectTrait.PERIODIC not in g.effect.traits}
        if instead is not None:
            taken.add(instead.key)
            rows = [set(self.rows(g)) for g in (group, instead)]
            if group.parts or not rows[0] & rows[1]:
                return False
        if taken & {group.key, *(p.key for p in group.parts)}:
            return False
        family = group.effect.family, group.joints
        if group.effect.family and family in {(g.effect.family, g.joints) for g in members}:
            return False
        return not any(
            _cancel(group, x) or _draws(group, x) or self._is_same_body(group, x) for x in members
        )

    def _is_same_body(self, first: CandidateColumns, second: CandidateColumns) -> bool:
        """Whether both are the body of one link, so that one suffices."""
        groups = first, second
        if any(g.effect.portable.bodies is None for g in groups):
            return False
        last = self.score.design.dof - 1
        links = {g.joints[0] if g.effect.scope == "link" else last for g in groups}
        return len(links) == 1

    def rows(self, group: CandidateColumns) -> Sequence[int]:
        """Joints (from 0) on which a group acts."""
        return group.effect.rows(group.joints, self.score.design.dof)

    def _choose(self, trials: Sequence[Trial], before: LeftOut) -> Trial | None:
        """Choose the most evidence that is supported and not exceeded by a curve.

        A curve stays if names explain less than three quarters of it.
        """
        outdone: Trial | None = None
        for trial in trials:
            after = trial.left_out
            if not self.is_borne_out(trial, after, before):
                continue
            if is_curve(trial.group):
                outdone = outdone or trial
                continue
            joint = after.find_main_joint(before)
            if outdone is not None and outdone.group.joints != (joint,):
                continue
            rivals = [
                t
                for t in trials
                if is_curve(t.group)
                and t.group.joints == (joint,)
                and _outdoes(t.left_out, after, before, joint)
            ]
            if not rivals:
                return self._find_simplest(trial, after, trials, before)
            outdone = outdone or max(rivals, key=lambda t: t.nats)
        return outdone

    def _find_simplest(
        self, best: Trial, after: LeftOut, trials: Sequence[Trial], before: LeftOut
    ) -> Trial:
        """The plainest name of those that blocks cannot separate from the best.

        Evidence is a t statistic and saturates: the ten coefficients of a body imitate
        an effect of one coefficient, and fit as well.
        """
        plain = _complexity(best.group)
        near = [
            t
            for t in trials
            if best.nats - t.nats < THRESHOLDS.class_nats
            and _complexity(t.group) < plain
            and not (is_curve(t.group) or t.group.parts)
        ]
        for trial in sorted(near, key=lambda t: _complexity(t.group)):
            left = trial.left_out
            if not self.is_borne_out(trial, left, before):
                continue
            if is_alike(after.gain_over(left)):
                return trial
        return best

    def _join(self, base: Fit, best: Trial) -> tuple[Fit, LeftOut]:
        members = (*base.members, *(best.group.parts or (best.group,)))
        if best.group.effect.refine and not best.group.parts:
            members = refine_last_shape(self.score, members, best.fit)
        fitted = self._split_friction(self.score.fit(members, best.fit))
        fitted = self._drop(fitted)
        return fitted, self.score.left_out(fitted)

    def _split_friction(self, fitted: Fit) -> Fit:
        """Replace the last name by one or two plain ones of its joint, if these fit better.

        More friction is a level and a slope; many curves lie between the two.
        """
        *others, last = fitted.members
        friction = EffectTrait.FRICTION
        if not last.shape or friction not in last.effect.traits or is_curve(last):
            return fitted
        plain = [
            g
            for g in self.candidates.groups
            if g.joints == last.joints
            and friction in g.effect.traits
            and len(g.ids) == 1
            and not (g.shape or g.parts)
            and self._fits_in(g, (*others,), None)
        ]
        best, members = fitted, tuple(others)
        for _ in range(min(2, len(plain))):
            fits = [self.score.fit_like((*members, g), fitted) for g in plain]
            members = fits[int(np.argmax([f.score for f in fits]))].members
            plain = [g for g in plain if g not in members]
            trial = self.score.fit(members, fitted)
            best = trial if self.leads(trial, best) else best
        return best

    def _drop(self, fitted: Fit) -> Fit:
        """Drop members that no longer carry their price, weakest first."""
        while True:
            known = self.score.covariances(fitted)
            worth = [self.score.nats(fitted, g, known) - self.cost(g) for g in fitted.members]
            if not worth or min(worth) >= 0:
                return fitted
            weakest = fitted.members[int(np.argmin(worth))]
            rest = tuple(g for g in fitted.members if g is not weakest)
            fitted = self.score.fit(rest, fitted)


def refine_last_shape(score: Score, members: Sequence[CandidateColumns], like: Fit) -> Members:
    """Refine the last member's nonlinear parameter off the grid."""
    *others, last = members
    how = last.effect.refine
    if how is None:
        return tuple(members)
    design, prior = score.design, score.prior
    reach = how.compute_half_width(last.joints, design.states[0].robot)
    offsets = np.linspace(-reach, reach, 7)
    system, size = FitEquations.of(design, prior, others), design.size
    centre, winner, top = last.shape[0], last, -np.inf
    for _ in range(3):
        points = centre * np.exp(offsets) if how.step == "ratio" else centre + offsets
        points = np.unique(np.clip(points, how.lower, how.upper))
        shapes = [last.placed._replace(shape=(float(x), *last.shape[1:])) for x in points]
        for group in design.add(shapes):
            trial = fit_jointly(
                design,
                prior,
                (*others, group),
                like.counted,
                like.variance,
                system=system.beside(design, group),
            )
            if trial.score > top and is_fit_possible(design, trial, group):
                top, winner = trial.score, group
        centre = winner.shape[0]
        offsets = np.array([-0.5, -0.2, 0.2, 0.5]) * (offsets[-1] - offsets[0]) / 6
    design.drop_newest_columns(size)  # keep one of the tried shapes
    if winner is not last:
        (winner,) = design.add([winner.placed])
    return (*others, replace(winner, fellows=last.fellows))


def _outdoes(curve: LeftOut, name: LeftOut, before: LeftOut, joint: int) -> bool:
    """Whether a name explains clearly less of its joint than a curve."""
    own, theirs, first = (x.errors[:, joint] for x in (curve, name, before))
    gain = theirs - own
    if gain.sum() <= THRESHOLDS.paired_deviations * compute_scatter(gain):
        return False
    share = THRESHOLDS.explained_share
    return bool((first - theirs).sum() < share * (first - own).sum())


_PLAIN = 0.0, False


def _complexity(group: CandidateColumns) -> tuple[float, bool]:
    """Rank of a name by plausibility, and whether it has ten coefficients of a body."""
    body = EffectTrait.BODY in group.effect.traits
    return group.effect.far_fetched, body and len(group.ids) > 1


def places_of(members: Sequence[CandidateColumns]) -> tuple:
    """Effects and joints of a set, regardless of shapes and order."""
    return tuple(sorted((g.effect.name, g.joints) for g in members))


def _draws(curve: CandidateColumns, name: CandidateColumns) -> bool:
    """Whether a curve and a name of its joint describe the same variable."""
    if not is_curve(curve) or is_curve(name) or name.joints != curve.joints:
        return False
    by_position = name.effect.variable is against_position
    return by_position == (curve.effect is CURVES["q"])


def _cancel(first: CandidateColumns, second: CandidateColumns) -> bool:
    """Whether two waves of one joint have nearly the same order."""
    if first.effect is not second.effect or first.joints != second.joints:
        return False
    if EffectTrait.PERIODIC not in first.effect.traits or not first.shape:
        return False
    ratio = first.shape[0] / second.shape[0]
    return 1 / THRESHOLDS.ripple_order_ratio < ratio < THRESHOLDS.ripple_order_ratio
