"""The score of a set of effects: evidence by blocks, and left-out blocks.

Errors within a block of some two seconds may be correlated, those of different blocks
are independent. The covariance of a fit is clustered by block (Liang and Zeger 1986) and
shrunk towards that of independent errors, since few blocks leave it uncertain. The
evidence of a member is a mixture of g-priors over four sizes (Zellner 1986),

    ln BF = (nu + 1) / 2 ln(1 + W / nu) - 1/2 ln det(I + g V^-1 P^-1) - price,

with W its Wald statistic under the prior P, V its covariance and nu = blocks +
``prior_blocks`` degrees of freedom: a t statistic.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dposv

from residual.evidence.columns import CandidateColumns
from residual.evidence.design import Design
from residual.evidence.fit import Fit, FitEquations, NominalPrior, count_effective_rows, fit_jointly
from residual.evidence.thresholds import THRESHOLDS
from residual.recording import Array
from residual.signals.splitting import group_pieces_by_log
from residual.signals.track import Track

MERGES = (1, 2, 4)  # numbers of merged blocks: the least evidence counts
SQUARES = np.array([1.0, 0.3, 0.1, 0.03]) ** 2  # of the prior size of an effect
SAME_NOISE = 0.02  # of the variance: fits from two starts have converged
FLAT = 1e-9  # of the largest eigenvalue: undetermined directions


def label_blocks(tracks: Sequence[Track]) -> list[Array]:
    """Number of the block of each row of the logs; no block spans two logs.

    Returns:
        Ascending numbers. Shapes (m,).
    """
    seconds = sum(track.seconds for track in tracks)
    length = max(THRESHOLDS.block_seconds, seconds / THRESHOLDS.max_blocks)
    length = min(length, seconds / THRESHOLDS.min_blocks)
    out, start = [], 0
    for pieces in group_pieces_by_log([track.id for track in tracks]):
        for i in pieces:
            rows = len(tracks[i].tau)
            count = max(1, int(tracks[i].seconds / length))
            out.append(start + np.arange(rows) * count // rows)
            start += count
    return out


def count_merged_blocks(blocks: int) -> list[int]:
    """Number of blocks when one, two or four are merged."""
    merged = [blocks // count for count in MERGES]
    return [n for n in merged if n in (blocks, max(n, THRESHOLDS.min_blocks))]


@dataclass(frozen=True, eq=False, slots=True)
class LeftOut:
    """Squared error of each block, predicted from the others."""

    errors: Array  # [N^2 m^2], (blocks, dof)
    weight: Array  # information of a unit of squared error, (dof,)

    def gain_over(self, other: "LeftOut") -> Array:
        """Gain in predicting each block over another fit [nats]. (blocks,)."""
        return 0.5 * (other.errors - self.errors) @ self.weight

    @property
    def total(self) -> float:
        """The weighted total error."""
        return float((self.errors @ self.weight).sum())

    def find_main_joint(self, other: "LeftOut") -> int:
        """The joint (from 0) on which it gains most over another."""
        return int(np.argmax((other.errors - self.errors).sum(axis=0) * self.weight))

    def fall_from(self, other: "LeftOut") -> Array:
        """Share of the other's squared error that it saves, by joint. Shape (dof,)."""
        before = np.maximum(other.errors.sum(axis=0), 1e-30)
        return 1 - self.errors.sum(axis=0) / before


def compute_scatter(gains: Array) -> float:
    """Standard deviation of the sum of independent gains of blocks."""
    return float(gains.std(ddof=1) * np.sqrt(len(gains)))


def is_alike(gains: Array) -> bool:
    """Whether such gains of blocks are not significant."""
    scatter = THRESHOLDS.paired_deviations * compute_scatter(gains)
    return bool(gains.sum() < max(THRESHOLDS.class_nats, scatter))


@dataclass(frozen=True, eq=False, slots=True)
class Score:
    """A design under a prior, for scoring sets of effects."""

    design: Design
    prior: NominalPrior

    def fit(
        self,
        members: Sequence[CandidateColumns],
        like: Fit | None = None,
        system: FitEquations | None = None,
    ) -> Fit:
        """Fit a set with its own noise, from the better of two starts.

        Noise and coefficients have two fixed points if an effect is missing: it counts
        as noise, or as parameters. The evidence chooses.

        Args:
            like: A fit whose row counts are the start.
            system: The normal equations of the set, if known.
        """
        design, prior = self.design, self.prior
        system = system or FitEquations.of(design, prior, members)

        def settle(start: Fit) -> Fit:
            rows = count_effective_rows(design, start)
            args = design, prior, members, rows, start.variance, 3, system
            return fit_jointly(*args)

        counted = design.rows / 5 if like is None else like.counted
        floor = (THRESHOLDS.noise_floor * design.rms) ** 2
        first, second = (
            fit_jointly(design, prior, members, rows, noise, 4, system)
            for rows, noise in ((counted, None), (design.rows, floor))
        )
        if np.allclose(first.variance, second.variance, rtol=SAME_NOISE):
            return settle(first)
        # Each has row counts from its own residual, both are compared at the larger
        # count: the worse may become the better there, so it is fitted further.
        fits = settle(first), settle(second)
        rows = np.maximum(fits[0].counted, fits[1].counted)
        common = [fit_jointly(design, prior, members, rows, f.variance, 3, system) for f in fits]
        return settle(max(common, key=lambda fitted: fitted.score))

    def fit_like(self, members: Sequence[CandidateColumns], like: Fit) -> Fit:
        """Fit a set with the row counts of another, to be compared with it."""
        args = self.design, self.prior, members, like.counted, like.variance
        return fit_jointly(*args, rounds=3)

    def covariances(self, fitted: Fit) -> list[tuple[Array, float]]:
        """Covariances of a fit from the disagreement of blocks, and their degrees.

        One for each number of merged blocks.
        """
        design, weight = self.design, fitted.weight
        merged = count_merged_blocks(design.folds)
        if design.unrest is not None:  # shows the length of correlations
            weight, merged = weight * design.unrest, merged[:1]
        pulls = np.zeros((design.folds, len(fitted.ids)))
        for j in range(design.dof):
            place, have = design.present(j, fitted.ids)
            votes = design.fold_rows[:, j] >= THRESHOLDS.min_block_rows
            own = design.fold_pulls(j, place, fitted.theta[have])
            pulls[:, have] += weight[j] * votes[:, None] * own
        plain, nu, out = fitted.covariance(), THRESHOLDS.prior_blocks, []
        for n in merged:
            labels = np.minimum(np.arange(design.folds) // (design.folds // n), n - 1)
            joined = np.zeros((n, pulls.shape[1]))
            np.add.at(joined, labels, pulls)
            joined -= joined.mean(axis=0)  # the prior's own pull is shared by all
            moved = joined @ plain
            robust = moved.T @ moved * n / max(n - 1, 1)
            out.append(((nu * plain + n * robust) / (nu + n), nu + n))
        return out

    def nats(
        self, fitted: Fit, group: CandidateColumns, covariances: Sequence[tuple[Array, float]] = ()
    ) -> float:
        """Evidence of a member of a fit, or of several, against none [nats]."""
        parts = group.parts or (group,)
        slots = np.concatenate([fitted.slots(g) for g in parts])
        theta = fitted.theta[slots]
        values = []
        for covariance, degrees in covariances or self.covariances(fitted):
            total = _invert(covariance[np.ix_(slots, slots)])
            own = total - group.precision
            pull, prior = total @ theta, group.precision
            values += mixture_evidence(own, pull, prior, degrees).tolist()
        return min(values)

    def left_out(self, fitted: Fit) -> LeftOut:
        """Errors of blocks, each predicted by a fit without it."""
        design = self.design
        system = FitEquations.of(design, self.prior, fitted.members)
        weight = fitted.weight
        whole = system.precision + np.tensordot(weight, system.gram, 1)
        unit = 1 / np.sqrt(np.diag(whole))
        left = np.repeat(whole[None], design.folds, axis=0)
        pull = np.tile(weight @ system.cross + system.pull, (design.folds, 1))
        sums = []
        for j, (at, have) in enumerate(system.present):
            gram, cross = design.fold_sums(j, at)
            sums.append((have, gram, cross))
            left[:, have[:, None], have] -= weight[j] * gram
            pull[:, have] -= weight[j] * cross
        left *= np.outer(unit, unit)
        # LAPACK directly, as in the fit: half the work of a general solver.
        pairs = zip(left, pull * unit, strict=True)
        theta = unit * np.stack([dposv(m, p, lower=1)[1] for m, p in pairs])
        errors = design.power.astype(float)
        for j, (have, gram, cross) in enumerate(sums):
            own = theta[:, have]
            moved = (gram @ own[..., None])[..., 0] - 2 * cross
            errors[:, j] += (own * moved).sum(axis=1)
        return LeftOut(np.maximum(errors, 0.0), weight)


def mixture_evidence(
    information: Array, pull: Array, prior: Array, degrees: float, sizes: Sequence[float] = (1.0,)
) -> Array:
    """Evidence under the likeliest of four sizes of the prior [nats]. Shape (s,).

    A load of a tenth of the typical size is still a load: the price of ten parameters
    depends on their size.

    Args:
        information: Information of the logs alone. Shape (k, k).
        pull: Information times the coefficients. Shape (k,).
        prior: Precision of the typical prior. Shape (k, k).
        sizes: Factors on the coefficients. Shape (s,).
    """
    scale = 1 / np.sqrt(np.diag(prior))
    lower = np.linalg.cholesky(prior * np.outer(scale, scale))
    half = np.linalg.inv(lower) * scale
    known, turn = np.linalg.eigh(half @ information @ half.T)
    known = np.maximum(known, 0.0)[:, None]
    along = (turn.T @ (half @ pull))[:, None] ** 2
    wald = np.outer(np.square(sizes), (along / (known + 1 / SQUARES)).sum(axis=0))
    worth = 0.5 * (degrees + 1) * np.log1p(wald / degrees)
    worth = worth - 0.5 * np.log1p(known * SQUARES).sum(axis=0)
    return worth.max(axis=1) - np.log(len(SQUARES))


def _invert(matrix: Array) -> Array:
    size = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    values, vectors = np.linalg.eigh(matrix / np.outer(size, size))
    values = np.maximum(values, FLAT * values[-1])
    return (vectors / values) @ vectors.T / np.outer(size, size)
