"""How likely it is that something changed, beside what is named already.

All that is known of one more candidate, given others, from sums over blocks: its size,
how sure that is where errors are as they are seen to be, and the evidence (Zellner's
g-prior, a t statistic for few blocks).
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.changes.joint import JointColumns, JointRows
from residual.changes.rows import EpochRows
from residual.effects import registry
from residual.effects.base import Effect, PlacedEffect, Shape, Trait
from residual.evidence.columns import Group
from residual.evidence.design import Design
from residual.recording import Array
from residual.verdict.result import Place

MODEL = 15.0  # blocks that independent errors of each joint's size count as, and
#              as many more as a candidate has columns
WIDE = 0.1  # of a prior's precision: the likely size of a change is no measure of it
FLAT = 1e-6  # of a column's square: below, it is none of its own
SQUARES = np.array([1.0, 0.3, 0.1, 0.03]) ** 2  # of the prior size of an effect


@dataclass(frozen=True, eq=False, slots=True)
class Candidate:
    """One effect that may have changed."""

    group: Group  # the effect, where, and its shape
    pieces: Mapping[int, JointColumns]  # its columns on each joint on which it acts
    price: float  # what it costs to be one of many [nats]
    before: Group  # what of it any arm may have had before

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
class Noise:
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
class Contrast:
    """What is known of one candidate, given the others."""

    candidate: Candidate  # the candidate
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


class ContrastTable:
    """All joints, and how their rows are weighed."""

    def __init__(
        self, joints: Mapping[int, JointRows], blocks: int, noise: Noise
    ) -> None:
        """Take the joints, the number of blocks in all, and the noise."""
        self.joints, self.blocks, self.noise = joints, blocks, noise
        self._products: dict[tuple[Candidate, Candidate, int], Array] = {}
        self._leverage: dict[tuple[Candidate, Candidate, int], Array] = {}

    @property
    def degrees(self) -> float:
        """Degrees of freedom of what is known of the errors."""
        return self.noise.blocks + MODEL

    def with_noise(self, noise: Noise) -> "ContrastTable":
        """The same under other noise."""
        out = ContrastTable(self.joints, self.blocks, noise)
        out._products, out._leverage = self._products, self._leverage
        return out

    def sums(self, some: Sequence[Candidate]) -> NormalEquations:
        """Normal equations of some candidates at once."""
        ends = np.cumsum([0, *(len(c.group.ids) for c in some)])
        out = NormalEquations.empty(int(ends[-1]), self.blocks)
        for a, one in enumerate(some):
            at = slice(ends[a], ends[a + 1])
            out.precision[at, at] = WIDE * one.group.precision
            for j, piece in one.pieces.items():
                self._add(out, j, (at, at), piece.gram, piece.plain, piece.lever)
                out.cross[at] += self.noise.weight[j] * piece.cross
                where = self.joints[j].layout.blocks
                for i, factor in enumerate((1.0, self.noise.unrest[j])):
                    pull = self.noise.weight[j] * factor * piece.pull
                    out.pull[i, where, at] += pull
                for b, other in enumerate(some[:a]):
                    if j in other.pieces:
                        to = slice(ends[b], ends[b + 1])
                        self._add_mixed(out, j, one, other, at, to)
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
        """Add a joint's products of two candidates to where they belong."""
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
        one: Candidate,
        other: Candidate,
        at: slice,
        to: slice,
    ) -> None:
        gram, lever = self._product(one, other, j), self._levers(one, other, j)
        plain = one.pieces[j].columns.T @ other.pieces[j].columns
        self._add(out, j, (at, to), gram, plain, lever)
        self._add(out, j, (to, at), gram.T, plain.T, lever.transpose(0, 2, 1))

    def _product(self, one: Candidate, other: Candidate, j: int) -> Array:
        key = one, other, j
        if key not in self._products:
            self._products[key] = one.pieces[j].columns.T @ other.pieces[j].raw
        return self._products[key]

    def _levers(self, one: Candidate, other: Candidate, j: int) -> Array:
        key = one, other, j
        if key not in self._leverage:
            pieces = one.pieces[j], other.pieces[j]
            self._leverage[key] = self.joints[j].levers(*pieces)
        return self._leverage[key]

    def fits(self, every: Sequence[Candidate], given: Sequence[Candidate]) -> Array:
        """Evidence of each candidate by the fall of the squared error. Shape (c,).

        As `Contrast.fit`, without a look at single blocks.
        """
        known = self.sums(given) if given else None
        alike: dict[tuple, list[int]] = {}
        for i, c in enumerate(every):
            alike.setdefault((len(c.group.ids), *c.pieces), []).append(i)
        out = np.empty(len(every))
        for (_, *on), numbers in alike.items():
            some = [every[i] for i in numbers]
            own, cross = self._stacked(some, on)
            if known is not None:
                mixed = np.stack([self._mixed(c, given) for c in some])
                turn = np.linalg.solve(known.gram + known.precision, mixed)
                own = own - mixed.transpose(0, 2, 1) @ turn
                cross = cross - np.einsum("gnk,n->gk", turn, known.cross)
            prior = np.stack([c.group.precision for c in some])
            price = np.array([c.price for c in some])
            out[numbers] = log_evidence(own, cross, prior, None) - price
        return out

    def _stacked(self, some: Sequence[Candidate], on) -> tuple[Array, Array]:
        weight = self.noise.weight
        own = sum(weight[j] * np.stack([c.pieces[j].gram for c in some]) for j in on)
        cross = sum(weight[j] * np.stack([c.pieces[j].cross for c in some]) for j in on)
        return own, cross

    def _mixed(self, one: Candidate, given: Sequence[Candidate]) -> Array:
        """Products of those that are given with one more candidate. Shape (n, k)."""
        parts = []
        for other in given:
            shape = len(other.group.ids), len(one.group.ids)
            own = np.zeros(shape)
            for j in one.pieces.keys() & other.pieces.keys():
                own += self.noise.weight[j] * self._product(other, one, j)
            parts.append(own)
        return np.concatenate(parts)

    def theta(self, some: Sequence[Candidate]) -> list[Array]:
        """Coefficients of several candidates, fitted together."""
        if not some:
            return []
        sums = self.sums(some)
        theta = np.linalg.solve(sums.gram + sums.precision, sums.cross)
        return np.split(theta, np.cumsum([len(c.group.ids) for c in some])[:-1])

    def contrast(self, one: Candidate, given: Sequence[Candidate] = ()) -> Contrast:
        """What is known of one candidate beside others."""
        sums = self.sums([*given, one])
        k = len(one.group.ids)
        n = len(sums.cross) - k
        gram = sums.gram + sums.precision
        old, new = slice(0, n), slice(n, n + k)
        turn = np.linalg.solve(gram[old, old], gram[old, new])  # (n, k)
        cross = sums.cross[new] - turn.T @ sums.cross[old]
        own = sums.gram[new, new] - turn.T @ gram[old, new]
        own = 0.5 * (own + own.T)
        inverse = np.linalg.inv(gram)
        score = sums.pull - sums.lever @ (inverse @ sums.cross)
        # What a fit without the block would have said of it.
        kept = np.eye(n + k) - sums.lever[0] @ inverse
        score = np.linalg.solve(kept, score[..., None])[..., 0]
        score = score[..., new] - score[..., old] @ turn
        meat = score[1].T @ score[1]
        spread, seen = MODEL + k, float((np.abs(score[0]).sum(axis=1) > 0).sum())
        mixed = sums.plain[old, new]
        errors = sums.plain[new, new] - turn.T @ mixed - mixed.T @ turn
        errors = errors + turn.T @ sums.plain[old, old] @ turn
        # What logs may differ by comes on top of what rows scatter by.
        meat = (seen * meat + spread * errors) / (seen + spread) + (own - errors)
        information, pulled = _information(own, meat, cross)
        found = self._concluded(one, information, pulled, cross, own)
        return replace(found, apart=_share_apart(sums.gram, n))

    def _concluded(self, one, information, pulled, cross, own) -> Contrast:
        prior = one.group.precision
        covariance = np.linalg.inv(information + WIDE * prior)
        return Contrast(
            candidate=one,
            theta=covariance @ pulled,
            covariance=covariance,
            information=information,
            nats=log_evidence(information, pulled, prior, self.degrees) - one.price,
            fit=log_evidence(own, cross, prior, None) - one.price,
            apart=1.0,
        )


def _share_apart(gram: Array, n: int) -> float:
    """Share of the last columns that the first n do not have, whatever their prior."""
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    gram = gram / np.outer(size, size)
    old = gram[:n, :n] + FLAT * np.eye(n)
    own = gram[n:, n:] - gram[n:, :n] @ np.linalg.solve(old, gram[:n, n:])
    return float(np.diag(own).mean())


def log_evidence(
    information: Array, pull: Array, prior: Array, nu: float | None
) -> Array:
    """Evidence under the likeliest size of the prior, of one or of many. Shape (...).

    A load of a tenth of the usual is no less a load: what it costs to know ten numbers
    goes by how large they are.
    """
    known, along = _modes(information, pull, prior)
    return _mixture_evidence(known, along**2, nu)


def expected_evidence(
    information: Array, way: Array, prior: Array, nu: float, sizes: Array
) -> Array:
    """The same of an effect of each size along a direction. Shape (sizes,)."""
    known, along = _modes(information, information @ way, prior)
    return _mixture_evidence(known, (sizes[:, None] * along) ** 2, nu)


def _modes(information: Array, pull: Array, prior: Array) -> tuple[Array, Array]:
    """Information along the principal axes under a prior, and the pull there."""
    if prior.shape[-1] == 1:
        own = prior[..., 0]
        return np.maximum(information[..., 0] / own, 0.0), pull / np.sqrt(own)
    scale = 1 / np.sqrt(np.diagonal(prior, axis1=-2, axis2=-1))
    lower = np.linalg.cholesky(prior * scale[..., :, None] * scale[..., None, :])
    half = np.linalg.inv(lower) * scale[..., None, :]
    known, turn = np.linalg.eigh(half @ information @ np.swapaxes(half, -1, -2))
    pulled = np.swapaxes(turn, -1, -2) @ (half @ pull[..., None])
    return np.maximum(known, 0.0), pulled[..., 0]


def _mixture_evidence(known: Array, squares: Array, nu: float | None) -> Array:
    known, squares = known[..., None], squares[..., None]
    wald = (squares / (known + 1 / SQUARES)).sum(axis=-2)
    worth = 0.5 * wald if nu is None else 0.5 * (nu + 1) * np.log1p(wald / nu)
    worth = worth - 0.5 * np.log1p(known * SQUARES).sum(axis=-2)
    return worth.max(axis=-1) - np.log(len(SQUARES))


def _information(own: Array, meat: Array, cross: Array) -> tuple[Array, Array]:
    """Information A B^-1 A and pull A B^-1 b of a robust estimate, as A may be flat."""
    size = np.sqrt(np.maximum(np.diag(own), 1e-300))
    a, b, c = own / np.outer(size, size), meat / np.outer(size, size), cross / size
    values, vectors = np.linalg.eigh(0.5 * (b + b.T))
    real = values > 1e-10 * max(values[-1], 1e-300)
    half = vectors[:, real] / np.sqrt(values[real])
    along = half.T @ a
    information = along.T @ along * np.outer(size, size)
    return information, (along.T @ (half.T @ c)) * size


# Every effect of the vocabulary that may have changed, on all joints.


def vocabulary(both: EpochRows, clocked: bool) -> tuple[list[Group], list[float]]:
    """Every effect that may have changed, on each joint and in each shape.

    Args:
        clocked: Whether each epoch's order of logs in time is known.

    Returns:
        The groups of columns, and what each costs as one of many [nats].
    """
    wanted, span, live = [], both.logs.span, set(both.live)
    for effect in registry().values():
        if Trait.NEEDS_CLOCK in effect.traits and not clocked:
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
        + (both.rules.nats_per_link if g.effect.of_link else 0.0)
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


def recompute_groups(both: EpochRows, known: Sequence[Candidate]) -> list[Group]:
    """The same groups, those that go by the model's torque seen anew."""
    old = [c.group for c in known]
    fresh = [g for g in old if Trait.USES_MODEL in g.effect.traits]
    made = iter(both.design.add([g.placed for g in fresh]))
    return [next(made) if Trait.USES_MODEL in g.effect.traits else g for g in old]


def refine_shape(
    both: EpochRows, joints: Mapping[int, JointRows], one: Candidate, width: float
) -> list[Candidate]:
    """The same candidate with shapes about its own.

    Args:
        width: How far to look, as a part of the reach of its effect.
    """
    group = one.group
    how = group.effect.refine
    reach = how.half_width(group.joints, both.design.states[0].robot)
    steps = width * reach * np.array([-1.0, -0.5, 0.5, 1.0])
    own = group.shape[0]
    first = own * np.exp(steps) if how.step == "ratio" else own + steps
    first = first[(first > how.lower) & (first < how.upper)]
    shapes = [(float(x), *group.shape[1:]) for x in first]
    made = both.design.add([group.placed._replace(shape=s) for s in shapes])
    before = [one.before if one.before is not group else g for g in made]
    return as_candidates(both.design, joints, made, [one.price] * len(made), before)


def as_candidates(
    design: Design,
    joints: Mapping[int, JointRows],
    groups: Sequence[Group],
    prices: Sequence[float],
    before: Sequence[Group] = (),
) -> list[Candidate]:
    """Groups of the design's columns as candidates.

    Args:
        prices: What each costs [nats].
        before: What of each may have been there before; the same where none is given.
    """
    before = before or groups
    pieces: list[dict[int, JointColumns]] = [{} for _ in groups]
    for j, joint in joints.items():
        on = [i for i, g in enumerate(groups) if design.acts(j, g)]
        if not on:
            continue
        ids = np.concatenate([groups[i].ids for i in on])
        was = np.concatenate([before[i].ids for i in on])
        own = _columns(design, j, ids)
        old = own if np.array_equal(ids, was) else _columns(design, j, was)
        sizes = [len(groups[i].ids) for i in on]
        made = joint.pieces(own, joint.layout.second, sizes, old)
        for i, piece in zip(on, made, strict=True):
            pieces[i][j] = piece
    every = zip(groups, pieces, prices, before, strict=True)
    return [Candidate(g, own, price, old) for g, own, price, old in every if own]


def _columns(design: Design, j: int, ids: Array) -> Array:
    return design.columns(j, design.present(j, ids)[0])
