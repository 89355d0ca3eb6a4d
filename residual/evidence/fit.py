"""Fit and evidence of a set of effects, with the noise profiled per joint.

The torque of joint j is y_j = X_j theta + e_j with theta ~ N(mu, P^-1): nominal
coefficients about their given values, effects under Zellner's g-prior (Zellner 1986).
With w_j = f / s_j, where N_j rows of variance s_j count as n_j and f is the geometric
mean of n_j / N_j, the posterior precision is A = P + sum_j w_j X_j' X_j, and the
evidence of a set, up to a constant, is

    ln p = -1/2 sum_j n_j ln s_j - 1/2 (theta - mu)' P (theta - mu)
           - 1/2 ln det A + 1/2 ln det P

(MacKay 1992; s_j = SSE_j / N_j and theta are iterated). Rows are autocorrelated, so
n_j = N_j / tau_j, with tau_j the integrated autocorrelation time of the residual
(initial positive pairs, Geyer 1992). Joints are weighted by their noise alone: if a joint
with a missing effect lost weight by its tau_j too, it would be fitted worse and lose
weight again, and which joint loses would be chance.

Impossible bodies are replaced by the nearest possible ones; undetermined parameters of a
body cost no torque. If the logs contradict every possible body beyond chance, the fitted
bodies absorb another effect: then no body is named (``PossibleModel.contradicted``).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag
from scipy.linalg.lapack import dpotrf, dpotri, dpotrs
from scipy.special import chdtrc

from residual.effects.base import Effect, EffectTrait, JointLimits
from residual.errors import join_with_commas
from residual.evidence.design import LAGS, CandidateColumns, Design
from residual.evidence.thresholds import THRESHOLDS
from residual.model.bodies import build_body_sums, find_nearest_possible
from residual.model.model import Model, Term, pair_coefficient_slices
from residual.model.nominal import NominalModel
from residual.model.records import BodyCorrection
from residual.recording import Array
from residual.robot.dynamics import compute_reach

CUT = 1e-10  # smaller eigenvalues of a scaled Gram matrix count as zero


@dataclass(frozen=True, eq=False, slots=True)
class NominalPrior:
    """Gaussian prior of the nominal model's coefficients about their nominal values."""

    precision: Array  # , (p, p)
    log_det: float  # its log determinant
    scale: float  # relative scale of the rigid part
    # Relative sd of each kind of given value, by the effect's name.
    widths: Mapping[str, float]


@dataclass(frozen=True, eq=False, slots=True)
class Fit:
    """Posterior of one set of effects."""

    members: tuple[CandidateColumns, ...]  # the effects
    ids: Array  # columns: the nominal model's, then each member's, (m,)
    theta: Array  # posterior mean (nominal: deviation from its value), (m,)
    cholesky: Array  # lower factor of the posterior precision, (m, m)
    variance: Array  # noise variance of each joint [N^2 m^2], (dof,)
    sse: Array  # squared error on the rows [N^2 m^2], (dof,)
    counted: Array  # effective number of rows of each joint, (dof,)
    share: Array  # share of the rows that count in the fit, (dof,)
    score: float  # log evidence up to a constant [nats]
    bent: float  # prior energy of the nominal coefficients [nats]

    def of(self, group: CandidateColumns) -> Array:
        """Coefficients of one member. Shape (k,)."""
        return self.theta[self.slots(group)]

    def slots(self, group: CandidateColumns) -> Array:
        """Indices of one member's coefficients. Shape (k,)."""
        start = len(self.ids) - sum(len(g.ids) for g in self.members)
        for member in self.members:
            if member is group:
                return np.arange(start, start + len(group.ids))
            start += len(member.ids)
        raise KeyError(group.key)

    def place(self, group: CandidateColumns) -> Array:
        """Indices of the coefficients of a group's columns. Shape (k,)."""
        where = {int(column): i for i, column in enumerate(self.ids)}
        return np.array([where[int(column)] for column in group.ids])

    @property
    def weight(self) -> Array:
        """Information of a unit of squared error [1 / N^2 m^2]. Shape (dof,)."""
        return self.share / self.variance

    def covariance(self) -> Array:
        """Posterior covariance. Shape (m, m)."""
        lower = np.tril(dpotri(self.cholesky, lower=1)[0])
        return lower + np.tril(lower, -1).T


def fit_jointly(
    design: Design,
    prior: NominalPrior,
    members: Sequence[CandidateColumns],
    counted: Array,
    variance: Array | None = None,
    rounds: int = 3,
    system: "FitEquations | None" = None,
) -> Fit:
    """Fit nominal and effects jointly; alternate coefficients and noise variance.

    Args:
        counted: Effective rows of each joint. Shape (dof,).
        variance: Noise variance to start from [N^2 m^2]. Shape (dof,).
        system: The normal equations of these members, if known already.
    """
    system = system or FitEquations.of(design, prior, members)
    floor = (THRESHOLDS.noise_floor * design.rms) ** 2
    sigma = system.power / design.rows + floor if variance is None else variance
    share = _share_rows(design, counted)
    for _ in range(rounds):
        theta, lower = system.solve(share / sigma)
        sse = system.squared_error(theta)
        sigma = sse / design.rows + floor
    p = len(design.nominal)
    energy = theta @ system.precision @ theta - 2 * theta @ system.pull + system.level
    score = (
        -0.5 * counted @ np.log(sigma)
        - 0.5 * energy
        - np.log(np.diag(lower)).sum()
        + 0.5 * system.log_det
    )
    bent = 0.5 * theta[:p] @ prior.precision @ theta[:p]
    return Fit(tuple(members), system.ids, theta, lower, sigma, sse, counted, share, score, bent)


def _share_rows(design: Design, counted: Array) -> Array:
    """Share of the rows that count, the same of all joints. Shape (dof,).

    Two epochs have separate ones: logs of a joint differ by more than its noise.
    """
    share, moving = counted / design.rows, design.rows >= THRESHOLDS.min_rows
    if design.unrest is not None or not moving.any():
        return share
    return np.full(design.dof, np.exp(np.log(share[moving]).mean()))


@dataclass(frozen=True, eq=False, slots=True)
class FitEquations:
    """Normal equations of one set of effects, per joint."""

    ids: Array  # columns, (m,)
    precision: Array  # prior precision of all of them, (m, m)
    # Pull of known values (``KnownPrior``), (m,).
    pull: Array
    level: float
    log_det: float  # its log determinant
    # Per joint, zero for columns that do not act on it, (dof, m, m), (dof, m).
    gram: Array
    cross: Array
    power: Array  # sum of squares of the target of each joint, (dof,)
    # Per joint, indices of the acting columns among its own, and their positions in
    # these (``Design.present``).
    present: tuple[tuple[Array, Array], ...]

    @classmethod
    def of(
        cls, design: Design, prior: NominalPrior, members: Sequence[CandidateColumns]
    ) -> "FitEquations":
        """Gather from the design."""
        ids = np.concatenate([design.nominal, *(g.ids for g in members)])
        p, m = len(design.nominal), len(ids)
        precision = np.zeros((m, m))
        precision[:p, :p] = prior.precision
        pull, level, log_det, start = np.zeros(m), 0.0, prior.log_det, p
        for g in members:
            stop, own = start + len(g.ids), g.prior
            precision[start:stop, start:stop] = g.precision + own.information
            pull[start:stop], level = own.pull, level + own.level
            log_det, start = log_det + own.log_det, stop
        gram, cross = np.zeros((design.dof, m, m)), np.zeros((design.dof, m))
        present = tuple(design.present(j, ids) for j in range(design.dof))
        for j, (place, have) in enumerate(present):
            gram[j, have[:, None], have], cross[j, have] = design.sums(j, place)
        power = design.power.sum(axis=0)
        return cls(ids, precision, pull, level, log_det, gram, cross, power, present)

    def beside(self, design: Design, group: CandidateColumns) -> "FitEquations":
        """Return the equations with one more effect; only its parts are gathered."""
        m, k = len(self.ids), len(group.ids)
        precision = np.zeros((m + k, m + k))
        own = group.prior
        precision[:m, :m] = self.precision
        precision[m:, m:] = group.precision + own.information
        gram = np.zeros((design.dof, m + k, m + k))
        cross = np.zeros((design.dof, m + k))
        gram[:, :m, :m], cross[:, :m] = self.gram, self.cross
        present = list(self.present)
        for j, (old, have) in enumerate(self.present):
            new, mine = design.present(j, group.ids)
            if not len(new):
                continue
            mine = mine + m
            present[j] = np.concatenate([old, new]), np.concatenate([have, mine])
            every, products = design.total(j)
            block = every[old[:, None], new]
            gram[j, have[:, None], mine] = block
            gram[j, mine[:, None], have] = block.T
            gram[j, mine[:, None], mine] = every[new[:, None], new]
            cross[j, mine] = products[new]
        ids = np.concatenate([self.ids, group.ids])
        return FitEquations(
            ids,
            precision,
            np.concatenate([self.pull, own.pull]),
            self.level + own.level,
            self.log_det + own.log_det,
            gram,
            cross,
            self.power,
            tuple(present),
        )

    def solve(self, weight: Array) -> tuple[Array, Array]:
        """Posterior mean and the lower Cholesky factor of its precision."""
        m = len(self.ids)
        a = self.precision + (weight @ self.gram.reshape(len(weight), -1)).reshape(m, m)
        a.ravel()[:: m + 1] *= 1 + 1e-12
        # LAPACK directly: SciPy's wrappers cost more than the work at this size.
        lower, failed = dpotrf(a, lower=1, clean=1)
        if failed:
            raise np.linalg.LinAlgError("normal equations are not positive definite")
        theta, _ = dpotrs(lower, weight @ self.cross + self.pull, lower=1)
        return theta, lower

    def squared_error(self, theta: Array) -> Array:
        """Squared error of each joint on the gathered rows. Shape (dof,)."""
        left = self.power - 2 * self.cross @ theta + (self.gram @ theta) @ theta
        return np.maximum(left, 0.0)


def solve_minimum_norm(gram: Array, cross: Array) -> Array:
    """Least squares of normal equations, without a prior. Shape (p,).

    If columns are dependent it is the smallest solution, in units of the torque of each
    column; undetermined coefficients are zero.

    Args:
        gram: Shape (p, p).
        cross: Shape (p,).
    """
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    seen = np.diag(gram) > CUT**2 * np.diag(gram).max()
    scaled = np.where(np.outer(seen, seen), gram / np.outer(scale, scale), 0.0)
    values, vectors = np.linalg.eigh(scaled)
    good = values > CUT * values[-1]
    right = vectors[:, good].T @ np.where(seen, cross / scale, 0.0)
    return np.where(seen, vectors[:, good] @ (right / values[good]) / scale, 0.0)


def invert_scaled(matrix: Array) -> Array:
    """Inverse of a positive definite matrix whose scales differ widely."""
    size = np.sqrt(np.diag(matrix))
    return np.linalg.inv(matrix / np.outer(size, size)) / np.outer(size, size)


def compute_zero_chance(coefficients: Array, covariance: Array, least: float) -> float:
    """Probability of coefficients at least this far from zero if they are zero.

    Args:
        coefficients: The coefficients. Shape (k,).
        covariance: Their covariance. Shape (k, k).
        least: Lower limit of the variance of a direction, of the correlation matrix.
    """
    size = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    values, vectors = np.linalg.eigh(covariance / np.outer(size, size))
    along = vectors.T @ (coefficients / size)
    squares = np.sum(along**2 / np.maximum(values, least))
    return float(chdtrc(len(coefficients), squares))


def count_effective_rows(design: Design, fitted: Fit) -> Array:
    """Rows over the autocorrelation time of the residual. Shape (dof,)."""
    out = np.empty(design.dof)
    for j in range(design.dof):
        left = design.residual(j, fitted.ids, fitted.theta)
        slow = estimate_autocorrelation_time(design.line(j, left))
        out[j] = min(max(design.rows[j] / slow, THRESHOLDS.min_rows), design.rows[j])
    return out if design.unrest is None else out / design.unrest**2


def estimate_autocorrelation_time(line: Array) -> float:
    """Integrated autocorrelation time of the rows of several logs (Geyer 1992).

    Args:
        line: Values of all logs on one time line, 0 where masked, the logs apart by
            ``LAGS`` rows and as many at the end (``Design.line``). Shape (n,).
    """
    spectrum = np.fft.rfft(line)
    acov = np.fft.irfft(spectrum.real**2 + spectrum.imag**2, len(line))[:LAGS]
    rho = acov / max(acov[0], 1e-30)
    pairs = rho[1:-1:2] + rho[2::2]
    stop = int(np.argmax(pairs <= 0)) if (pairs <= 0).any() else len(pairs)
    return float(1 + 2 * pairs[:stop].sum())


def refit_effective_rows(design: Design, prior: NominalPrior, fitted: Fit) -> Fit:
    """Count rows anew by the fit's own residual and fit again."""
    counted = count_effective_rows(design, fitted)
    return fit_jointly(design, prior, fitted.members, counted, fitted.variance)


def fit_nominal(design: Design, prior: NominalPrior) -> Fit:
    """Fit of the nominal structure alone."""
    return refit_effective_rows(
        design, prior, fit_jointly(design, prior, (), design.rows / 5, rounds=4)
    )


BODY = 10  # inertial parameters of a link


def is_fit_possible(design: Design, fitted: Fit, group: CandidateColumns) -> bool:
    """Whether a fitted effect is physically possible.

    For an effect on several joints every part is checked later, separately.
    """
    if group.parts:
        return True
    limits = find_group_limits(design, fitted, group)
    theta = fitted.of(group)
    signs = (1, -1) if design.may_fall(group) else (1,)
    return any(group.effect.possible(x * theta, group.shape, limits) for x in signs)


def find_group_limits(design: Design, fit: Fit, group: CandidateColumns) -> JointLimits:
    """Return the limits of the arm at the joints of a group.

    Args:
        fit: The fit with the group, or to which it would be added.
    """
    robot = design.model.robot
    on = list(group.joints) or list(range(design.dof))
    # The log shows that a limit is wrong.
    seen, limit = design.peak, robot.torque_limit
    known = np.isfinite(limit) & (limit > 0)
    unknown = THRESHOLDS.unknown_limit_factor * seen
    torque = np.where(known, np.maximum(limit, seen), unknown)
    weight = float(sum(body.mass for body in robot.model.inertias))
    reach = compute_reach(robot.model)
    if robot.dof == 1 and reach:
        # The load of a single joint is its body: up to what the joint can hold.
        weight = max(weight, float(torque[0]) / (9.81 * reach))
    return JointLimits(
        torque=float(torque[on].max()),
        lower=float(robot.lower[on].min()),
        upper=float(robot.upper[on].max()),
        speed=float(design.speed[on].max()),
        weight=weight,
        reach=reach,
        nominal_coefficients=_model_coefficients(design, fit, group),
        load_mass_seen=robot.dof > 1,
    )


def _model_coefficients(design: Design, fitted: Fit, group: CandidateColumns) -> Array:
    """The model's coefficients of the effect, refitted. Shape (k,)."""
    model, now = design.model, design.coefficients(fitted.theta)
    if group.effect.carries == "body":
        end = BODY * design.dof
        return now[end - BODY : end]
    out = np.zeros(len(group.ids))
    for term, own in pair_coefficient_slices(model.terms, len(model.inertial)):
        same = term.effect.name == group.effect.name and term.joints == group.joints
        if same and term.shape == group.shape:
            out = out + now[own]
    return out


def keep_physical_terms(model: Model) -> Model:
    """Keep only terms with physical parameters: loads, friction levels, rotors.

    A feature that depends on the model's torque must not contain another finding: a
    torque gain times an identified warm-up would explain the warm-up.
    """
    terms = tuple(t for t in model.terms if EffectTrait.PARAMETER in t.effect.traits)
    return replace(model, terms=terms, tables=())


def build_fitted_model(nominal: NominalModel, fitted: Fit) -> Model:
    """Nominal model moved by a fit's coefficients, its members added as terms."""
    base = nominal.model
    count = len(base.coefficients())
    moved = base.with_coefficients(base.coefficients() + fitted.theta[:count])
    new = tuple(Term(g.effect, g.joints, g.shape, fitted.of(g)) for g in fitted.members)
    return replace(moved, terms=(*moved.terms, *new))


def add_nominal_values(model: Model, fitted: Fit) -> Array:
    """The coefficients of a fit, the values of its nominal model added. Shape (m,)."""
    theta, base = fitted.theta.copy(), model.coefficients()
    theta[: len(base)] += base
    return theta


def select_coefficients(
    model: Model, fitted: Fit, selects: Callable[[Effect, tuple[int, ...]], bool]
) -> Array:
    """Mask of the coefficients of the selected effects of a fit. Shape (m,).

    Args:
        model: The nominal model of the fit.
        selects: Whether to select an effect on its joints, from 0.
    """
    marks = [np.zeros(len(model.inertial), dtype=bool)]
    for part in (*model.terms, *fitted.members):
        count = len(part.theta) if isinstance(part, Term) else len(part.ids)
        marks.append(np.full(count, bool(selects(part.effect, part.joints))))
    return np.concatenate(marks)


LITTLE = 0.01  # per cent of torque: less is not reported


@dataclass(frozen=True, eq=False, slots=True)
class PossibleModel:
    """A model with possible links and load."""

    model: Model  # the model
    # Impossible bodies of the free fit; None if every body is possible.
    correction: BodyCorrection | None
    # Whether the logs contradict every possible body: beyond chance, and on some joint
    # by as much as a finding must explain.
    contradicted: bool = False

    @property
    def notes(self) -> tuple[str, ...]:
        """The corrected bodies and their cost, in words; empty if all are possible."""
        if self.correction is None:
            return ()
        cost = 100 * max(*self.correction.price, 0.0)
        more = f"{cost:.2g} %" if cost >= LITTLE else f"under {LITTLE:g} %"
        return (
            "the unconstrained fit gives physically impossible inertias for "
            f"{join_with_commas(self.correction.bodies)}: the model uses the nearest "
            "possible ones (positive definite pseudo-inertia), which raise the torque "
            f"error of a joint by {more} at most",
        )

    @property
    def doubts(self) -> tuple[str, ...]:
        """The contradiction, in a sentence; empty if it may be chance."""
        if self.correction is None or not self.contradicted:
            return ()
        return (
            "the logs give physically impossible inertias for "
            f"{join_with_commas(self.correction.bodies)}: check gravity, signs, units, "
            "the order of the joints and external forces on the arm",
        )


@dataclass(frozen=True, eq=False, slots=True)
class SeparateTerm:
    """A term fitted separately."""

    covariance: Array  # of its coefficients, (k, k)
    columns: tuple[Array, ...]  # its torque on the rows of each joint, (rows, k)


def fit_possible_bodies(
    design: Design, fitted: Fit, model: Model, separate_terms: Sequence[SeparateTerm] = ()
) -> PossibleModel:
    """Return the nearest model to a fitted one with possible bodies.

    Args:
        fitted: The fit of the model.
        model: The fit as a model; after its coefficients those of ``separate_terms``.
    """
    best = model.coefficients()
    bodies = build_body_sums(model)
    impossible = bodies.list_impossible(best)
    if not impossible:
        return PossibleModel(model, None)
    apart = [np.linalg.cholesky(invert_scaled(b.covariance)).T for b in separate_terms]
    nearest = find_nearest_possible(bodies, best, block_diag(fitted.cholesky.T, *apart))
    before, after = (
        _mean_squares(design, fitted, separate_terms, gap)
        for gap in (np.zeros(len(best)), nearest - best)
    )
    price = (np.sqrt(after) - np.sqrt(before)) / design.rms
    # Twice the fall of log likelihood is chi-square, with the free parameters of bodies.
    fall = float(fitted.weight @ (design.rows * (after - before)))
    chance = float(chdtrc(BODY * len(impossible), max(fall, 0.0)))
    correction = BodyCorrection(impossible, tuple(float(p) for p in price), chance)
    # No arm has exactly the form of its model: less than a finding does not count.
    large = (price >= THRESHOLDS.min_fall).any()
    # Correct for the number of bodies, as for links.
    sure = chance < THRESHOLDS.link_zero_chance
    return PossibleModel(model.with_coefficients(nearest), correction, bool(large and sure))


def _mean_squares(design: Design, fitted: Fit, beside: Sequence[SeparateTerm], gap: Array) -> Array:
    """Mean square residual of each joint after a correction [N^2 m^2]. (dof,)."""
    ends = np.cumsum([0, *(len(b.covariance) for b in beside)])[: len(beside)]
    own, *others = np.split(gap, len(fitted.ids) + ends)
    out = np.zeros(design.dof)
    for j in range(design.dof):
        left = design.residual(j, fitted.ids, fitted.theta + own)
        for term, change in zip(beside, others, strict=True):
            left = left - term.columns[j] @ change
        out[j] = np.mean(left**2) if len(left) else 0.0
    return out
