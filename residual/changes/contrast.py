"""Evidence that an effect changed between two epochs, given the changes named already.

The rows of joint j are y = X beta + N eta + 1[second] Z theta + e: model and nuisance
are shared by both epochs, only theta is a change. With the nuisance projected out, the
sums over blocks b of 2 s give A = sum_b Z_b' W Z_b, the scores s_b of the blocks as a
fit without each block predicts them (CR2, Bell and McCaffrey 2002), and the robust
covariance V = A^-1 (sum_b s_b s_b') A^-1 (Liang and Zeger 1986), shrunk towards the
model-based one. The evidence is a mixture of g-priors over four sizes of the effect,

    ln BF = (nu + 1) / 2 ln(1 + W / nu) - 1/2 ln det(I + g V^-1 P^-1) - price,

with W the Wald statistic under the prior and nu = blocks + `MODEL` degrees of freedom:
a t statistic, since few blocks leave the covariance uncertain.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.changes.rows import EpochRows, JointRows, ProjectedColumns
from residual.effects import load_effects
from residual.effects.base import Effect, EffectTrait, PlacedEffect, Shape
from residual.evidence.columns import CandidateColumns
from residual.evidence.design import Design
from residual.recording import Array
from residual.verdict.result import Place

MODEL = 15.0  # blocks that independent errors of each joint's size count as, and
#              as many more as a candidate has columns
WIDE = 0.1  # of a prior's precision: the likely size of a change is no measure of it
FLAT = 1e-6  # of a column's square: below, it is none of its own
SQUARES = np.array([1.0, 0.3, 0.1, 0.03]) ** 2  # of the prior size of an effect


@dataclass(frozen=True, eq=False, slots=True)
class ChangeCandidate:
    """One effect that may have changed."""

    group: CandidateColumns  # the effect, where, and its shape
    pieces: Mapping[int, ProjectedColumns]  # its columns on each joint on which it acts
    price: float  # what it costs to be one of many [nats]
    before: CandidateColumns  # what of it any arm may have had before

    @property
    def key(self) -> tuple:
        """Its name and place, apart from a shape."""
        return self.group.key

    @property
    def place(self) -> Place:
        """The effect, and its joints from 1."""
        joints = tuple(j + 1 for j in self.group.joints)
        return Place(self.group.effect.name, joints)


@dataclass(frozen=True, eq=False, slots=True)
class JointNoise:
    """What errors of each joint are taken to be."""

    variance: Array  # of a row [N^2 m^2], (dof,)
    slow: Array  # rows that are as good as one, (dof,)
    # By how much logs differ without a change, as a factor on standard deviations,
    # (dof,).
    unrest: Array
    blocks: float  # blocks of the smaller epoch

    @property
    def weight(self) -> Array:
        """Information of a unit of squared error [1/(N^2 m^2)]. Shape (dof,)."""
        return 1 / (self.variance * self.slow * self.unrest**2)


@dataclass(frozen=True, eq=False, slots=True)
class ChangeEstimate:
    """What is known of one candidate, given the others."""

    candidate: ChangeCandidate  # the candidate
    theta: Array  # its coefficients, (k,)
    covariance: Array  # of them, blocks and unrest counted, (k, k)
    information: Array  # of the logs alone, without a prior, (k, k)
    nats: float  # evidence that it changed, by how errors are seen to be
    fit: float  # evidence by the fall of the squared error: to choose between names
    apart: float  # share of its torque that the others could not have by other sizes


@dataclass(frozen=True, eq=False, slots=True)
class NormalEquations:
    """Normal equations of several candidates, and their blocks."""

    # Products with what the nuisance leaves, and of that, (n, n).
    gram: Array
    plain: Array
    cross: Array  # with the torque, (n,)
    # By block, as they are and with restless joints enlarged, (2, blocks, n), (2,
    # blocks, n, n).
    pull: Array
    lever: Array
    precision: Array  # of the priors, (n, n)

    @classmethod
    def empty(cls, n: int, blocks: int) -> "NormalEquations":
        """Sums of nothing yet."""
        return cls(
            gram=np.zeros((n, n)),
            plain=np.zeros((n, n)),
            cross=np.zeros(n),
            pull=np.zeros((2, blocks, n)),
            lever=np.zeros((2, blocks, n, n)),
            precision=np.zeros((n, n)),
        )


class ChangeRegression:
    """All joints, and how their rows are weighed."""

    def __init__(
        self, joints: Mapping[int, JointRows], blocks: int, noise: JointNoise
    ) -> None:
        """Take the joints, the number of blocks in all, and the noise."""
        self.joints, self.blocks, self.noise = joints, blocks, noise
        self._products: dict[tuple[ChangeCandidate, ChangeCandidate, int], Array] = {}
        self._leverage: dict[tuple[ChangeCandidate, ChangeCandidate, int], Array] = {}

    @property
    def degrees(self) -> float:
        """Degrees of freedom of what is known of the errors."""
        return self.noise.blocks + MODEL

    def with_noise(self, noise: JointNoise) -> "ChangeRegression":
        """The same under other noise."""
        out = ChangeRegression(self.joints, self.blocks, noise)
        out._products, out._leverage = self._products, self._leverage
        return out

    def sums(self, candidates: Sequence[ChangeCandidate]) -> NormalEquations:
        """Normal equations of some candidates at once."""
        ends = np.cumsum([0, *(len(c.group.ids) for c in candidates)])
        out = NormalEquations.empty(int(ends[-1]), self.blocks)
        for a, first in enumerate(candidates):
            at = slice(ends[a], ends[a + 1])
            out.precision[at, at] = WIDE * first.group.precision
            for j, piece in first.pieces.items():
                self._add(out, j, (at, at), piece.gram, piece.plain, piece.lever)
                out.cross[at] += self.noise.weight[j] * piece.cross
                where = self.joints[j].layout.blocks
                for i, factor in enumerate((1.0, self.noise.unrest[j])):
                    pull = self.noise.weight[j] * factor * piece.pull
                    out.pull[i, where, at] += pull
                for b, second in enumerate(candidates[:a]):
                    if j in second.pieces:
                        to = slice(ends[b], ends[b + 1])
                        self._add_mixed(out, j, first, second, at, to)
        return out

    def _add(
        self,
        out: NormalEquations,
        j: int,
        at: tuple[slice, slice],
        gram: Array,
        plain: Array,
        lever: Array,
    ) -> None:
        weight, where = self.noise.weight[j], self.joints[j].layout.blocks
        out.gram[at] += weight * gram
        out.plain[at] += weight * plain
        # As it is, and with the scores of restless joints enlarged.
        out.lever[0, where, *at] += weight * lever
        out.lever[1, where, *at] += weight * self.noise.unrest[j] * lever

    def _add_mixed(
        self,
        out: NormalEquations,
        j: int,
        first: ChangeCandidate,
        second: ChangeCandidate,
        at: slice,
        to: slice,
    ) -> None:
        gram, lever = self._product(first, second, j), self._levers(first, second, j)
        plain = first.pieces[j].columns.T @ second.pieces[j].columns
        self._add(out, j, (at, to), gram, plain, lever)
        self._add(out, j, (to, at), gram.T, plain.T, lever.transpose(0, 2, 1))

    def _product(
        self, first: ChangeCandidate, second: ChangeCandidate, j: int
    ) -> Array:
        key = first, second, j
        if key not in self._products:
            self._products[key] = first.pieces[j].columns.T @ second.pieces[j].raw
        return self._products[key]

    def _levers(self, first: ChangeCandidate, second: ChangeCandidate, j: int) -> Array:
        key = first, second, j
        if key not in self._leverage:
            pieces = first.pieces[j], second.pieces[j]
            self._leverage[key] = self.joints[j].levers(*pieces)
        return self._leverage[key]

    def fits(
        self, every: Sequence[ChangeCandidate], named: Sequence[ChangeCandidate]
    ) -> Array:
        """Evidence of each candidate by the fall of the squared error. Shape (c,).

        As `contrast`, without a look at single blocks.
        """
        named_sums = self.sums(named) if named else None
        by_size: dict[tuple, list[int]] = {}
        for i, c in enumerate(every):
            by_size.setdefault((len(c.group.ids), *c.pieces), []).append(i)
        out = np.empty(len(every))
        for (_, *on), numbers in by_size.items():
            members = [every[i] for i in numbers]
            gram, cross = self._stacked(members, on)
            if named_sums is not None:
                mixed = np.stack([self._mixed(c, named) for c in members])
                turn = np.linalg.solve(named_sums.gram + named_sums.precision, mixed)
                gram = gram - mixed.transpose(0, 2, 1) @ turn
                cross = cross - np.einsum("gnk,n->gk", turn, named_sums.cross)
            prior = np.stack([c.group.precision for c in members])
            price = np.array([c.price for c in members])
            out[numbers] = change_log_evidence(gram, cross, prior, None) - price
        return out

    def _stacked(self, some: Sequence[ChangeCandidate], on) -> tuple[Array, Array]:
        weight = self.noise.weight
        gram = sum(weight[j] * np.stack([c.pieces[j].gram for c in some]) for j in on)
        cross = sum(weight[j] * np.stack([c.pieces[j].cross for c in some]) for j in on)
        return gram, cross

    def _mixed(
        self, candidate: ChangeCandidate, named: Sequence[ChangeCandidate]
    ) -> Array:
        """Products of the given candidates with one more. Shape (n, k)."""
        parts = []
        for named_candidate in named:
            shape = len(named_candidate.group.ids), len(candidate.group.ids)
            products = np.zeros(shape)
            for j in candidate.pieces.keys() & named_candidate.pieces.keys():
                products += self.noise.weight[j] * self._product(
                    named_candidate, candidate, j
                )
            parts.append(products)
        return np.concatenate(parts)

    def theta(self, some: Sequence[ChangeCandidate]) -> list[Array]:
        """Coefficients of several candidates, fitted together."""
        if not some:
            return []
        sums = self.sums(some)
        theta = np.linalg.solve(sums.gram + sums.precision, sums.cross)
        return np.split(theta, np.cumsum([len(c.group.ids) for c in some])[:-1])

    def contrast(
        self, candidate: ChangeCandidate, named: Sequence[ChangeCandidate] = ()
    ) -> ChangeEstimate:
        """What is known of one candidate beside others."""
        sums = self.sums([*named, candidate])
        k = len(candidate.group.ids)
        n = len(sums.cross) - k
        gram = sums.gram + sums.precision
        named_slots, slots = slice(0, n), slice(n, n + k)
        named_gram = gram[named_slots, named_slots]
        turn = np.linalg.solve(named_gram, gram[named_slots, slots])  # (n, k)
        cross = sums.cross[slots] - turn.T @ sums.cross[named_slots]
        beyond = sums.gram[slots, slots] - turn.T @ gram[named_slots, slots]
        beyond = 0.5 * (beyond + beyond.T)
        inverse = np.linalg.inv(gram)
        score = sums.pull - sums.lever @ (inverse @ sums.cross)
        # What a fit without the block would have said of it.
        kept = np.eye(n + k) - sums.lever[0] @ inverse
        score = np.linalg.solve(kept, score[..., None])[..., 0]
        score = score[..., slots] - score[..., named_slots] @ turn
        meat = score[1].T @ score[1]
        spread, seen = MODEL + k, float((np.abs(score[0]).sum(axis=1) > 0).sum())
        mixed = sums.plain[named_slots, slots]
        errors = sums.plain[slots, slots] - turn.T @ mixed - mixed.T @ turn
        errors = errors + turn.T @ sums.plain[named_slots, named_slots] @ turn
        # What logs may differ by comes on top of what rows scatter by.
        meat = (seen * meat + spread * errors) / (seen + spread) + (beyond - errors)
        information, pulled = _information(beyond, meat, cross)
        contrast = self._concluded(candidate, information, pulled, cross, beyond)
        return replace(contrast, apart=_share_apart(sums.gram, n))

    def _concluded(self, candidate, information, pulled, cross, gram) -> ChangeEstimate:
        prior = candidate.group.precision
        covariance = np.linalg.inv(information + WIDE * prior)
        return ChangeEstimate(
            candidate=candidate,
            theta=covariance @ pulled,
            covariance=covariance,
            information=information,
            nats=change_log_evidence(information, pulled, prior, self.degrees)
            - candidate.price,
            fit=change_log_evidence(gram, cross, prior, None) - candidate.price,
            apart=1.0,
        )


def _share_apart(gram: Array, n: int) -> float:
    """Share of the last columns outside the span of the first n."""
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    gram = gram / np.outer(size, size)
    first_gram = gram[:n, :n] + FLAT * np.eye(n)
    remaining = gram[n:, n:] - gram[n:, :n] @ np.linalg.solve(first_gram, gram[:n, n:])
    return float(np.diag(remaining).mean())


def change_log_evidence(
    information: Array, projection: Array, prior: Array, nu: float | None
) -> Array:
    """Evidence under the likeliest size of the prior, of one or of many. Shape (...).

    A load of a tenth of the usual is no less a load: what it costs to know ten numbers
    goes by how large they are.
    """
    known, along = _modes(information, projection, prior)
    return _mixture_evidence(known, along**2, nu)


def expected_evidence(
    information: Array, direction: Array, prior: Array, nu: float, sizes: Array
) -> Array:
    """The same of an effect of each size along a direction. Shape (sizes,)."""
    known, along = _modes(information, information @ direction, prior)
    return _mixture_evidence(known, (sizes[:, None] * along) ** 2, nu)


def _modes(information: Array, pull: Array, prior: Array) -> tuple[Array, Array]:
    """Information and pull along the principal axes under a prior."""
    if prior.shape[-1] == 1:
        scale = prior[..., 0]
        return np.maximum(information[..., 0] / scale, 0.0), pull / np.sqrt(scale)
    scale = 1 / np.sqrt(np.diagonal(prior, axis1=-2, axis2=-1))
    lower = np.linalg.cholesky(prior * scale[..., :, None] * scale[..., None, :])
    half = np.linalg.inv(lower) * scale[..., None, :]
    information, turn = np.linalg.eigh(half @ information @ np.swapaxes(half, -1, -2))
    pulled = np.swapaxes(turn, -1, -2) @ (half @ pull[..., None])
    return np.maximum(information, 0.0), pulled[..., 0]


def _mixture_evidence(information: Array, squares: Array, nu: float | None) -> Array:
    information, squares = information[..., None], squares[..., None]
    wald = (squares / (information + 1 / SQUARES)).sum(axis=-2)
    worth = 0.5 * wald if nu is None else 0.5 * (nu + 1) * np.log1p(wald / nu)
    worth = worth - 0.5 * np.log1p(information * SQUARES).sum(axis=-2)
    return worth.max(axis=-1) - np.log(len(SQUARES))


def _information(gram: Array, meat: Array, cross: Array) -> tuple[Array, Array]:
    """Information A B^-1 A and pull A B^-1 b of a robust fit; A may be singular."""
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    a, b, c = gram / np.outer(size, size), meat / np.outer(size, size), cross / size
    values, vectors = np.linalg.eigh(0.5 * (b + b.T))
    real = values > 1e-10 * max(values[-1], 1e-300)
    half = vectors[:, real] / np.sqrt(values[real])
    along = half.T @ a
    information = along.T @ along * np.outer(size, size)
    return information, (along.T @ (half.T @ c)) * size


# Every effect of the vocabulary that may have changed, on all joints.


def build_change_groups(
    both: EpochRows, clocked: bool
) -> tuple[list[CandidateColumns], list[float]]:
    """Every effect that may have changed, on each joint and in each shape.

    Args:
        clocked: Whether each epoch's order of logs in time is known.

    Returns:
        The groups of columns, and what each costs as one of many [nats].
    """
    wanted, span, live = [], both.logs.span, set(both.analyzable_joints)
    for effect in load_effects().values():
        if EffectTrait.NEEDS_CLOCK in effect.traits and not clocked:
            continue
        for on in effect.candidates(both.design.dof, span.prismatic):
            if effect.scope in ("local", "pair") and not set(on) <= live:
                continue
            shapes = _extend_shapes(effect, effect.shapes(span, on[0] if on else 0))
            wanted += [PlacedEffect(effect, on, shape) for shape in shapes]
    groups = both.design.add(wanted)
    variants = Counter(g.key for g in groups)
    prices = [
        float(np.log(len(variants)) + np.log(variants[g.key]))
        + (both.rules.nats_per_link if g.effect.replaces_link else 0.0)
        for g in groups
    ]
    return groups, prices


def _extend_shapes(effect: Effect, shapes: Sequence[Shape]) -> list[Shape]:
    """Shapes on a grid of ratios, up to the largest that the effect can have.

    A change may be larger than what an arm is delivered with.
    """
    out, how = list(shapes), effect.refine
    if how is None or how.step != "ratio" or len(out) < 2 or not np.isfinite(how.upper):
        return out
    ratio = out[-1][0] / out[-2][0]
    while ratio > 1 and out[-1][0] * ratio < how.upper:
        out.append((out[-1][0] * ratio, *out[-1][1:]))
    return out


def recompute_groups(
    both: EpochRows, candidates: Sequence[ChangeCandidate]
) -> list[CandidateColumns]:
    """The same groups, those that go by the model's torque seen anew."""
    groups = [c.group for c in candidates]
    reading = [g for g in groups if EffectTrait.USES_MODEL in g.effect.traits]
    recomputed = iter(both.design.add([g.placed for g in reading]))
    return [
        next(recomputed) if EffectTrait.USES_MODEL in g.effect.traits else g
        for g in groups
    ]


def shift_candidate_shape(
    both: EpochRows,
    joints: Mapping[int, JointRows],
    candidate: ChangeCandidate,
    width: float,
) -> list[ChangeCandidate]:
    """The same candidate with shapes about its own.

    Args:
        width: How far to look, as a part of the reach of its effect.
    """
    group = candidate.group
    how = group.effect.refine
    reach = how.compute_half_width(group.joints, both.design.states[0].robot)
    steps = width * reach * np.array([-1.0, -0.5, 0.5, 1.0])
    value = group.shape[0]
    values = value * np.exp(steps) if how.step == "ratio" else value + steps
    values = values[(values > how.lower) & (values < how.upper)]
    shapes = [(float(x), *group.shape[1:]) for x in values]
    groups = both.design.add([group.placed._replace(shape=s) for s in shapes])
    before = [candidate.before if candidate.before is not group else g for g in groups]
    return build_change_candidates(
        both.design, joints, groups, [candidate.price] * len(groups), before
    )


def build_change_candidates(
    design: Design,
    joints: Mapping[int, JointRows],
    groups: Sequence[CandidateColumns],
    prices: Sequence[float],
    before: Sequence[CandidateColumns] = (),
) -> list[ChangeCandidate]:
    """Groups of the design's columns as candidates.

    Args:
        prices: What each costs [nats].
        before: What of each may have been there before; the same where none is given.
    """
    before = before or groups
    pieces: list[dict[int, ProjectedColumns]] = [{} for _ in groups]
    for j, joint in joints.items():
        on = [i for i, g in enumerate(groups) if design.acts(j, g)]
        if not on:
            continue
        ids = np.concatenate([groups[i].ids for i in on])
        before_ids = np.concatenate([before[i].ids for i in on])
        columns = _columns(design, j, ids)
        before_columns = (
            columns
            if np.array_equal(ids, before_ids)
            else _columns(design, j, before_ids)
        )
        sizes = [len(groups[i].ids) for i in on]
        pieces_made = joint.pieces(columns, joint.layout.second, sizes, before_columns)
        for i, piece in zip(on, pieces_made, strict=True):
            pieces[i][j] = piece
    every = zip(groups, pieces, prices, before, strict=True)
    return [
        ChangeCandidate(g, columns, price, before_columns)
        for g, columns, price, before_columns in every
        if columns
    ]


def _columns(design: Design, j: int, ids: Array) -> Array:
    return design.columns(j, design.present(j, ids)[0])
