"""Priors of the nominal model, and quick screening of every candidate."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.linalg import solve_triangular

from residual.effects import load_effects
from residual.effects.base import EffectTrait
from residual.evidence.design import CandidateColumns, Design
from residual.evidence.fit import Fit, FitEquations, NominalPrior, build_fitted_model, fit_nominal
from residual.evidence.thresholds import THRESHOLDS
from residual.model.model import Model, pair_coefficient_slices
from residual.model.nominal import (
    ASSUMED,
    EXACT,
    GIVEN,
    FitLogs,
    NominalModel,
    compute_known_value_information,
    read_known_masses,
    select_effect_values,
)
from residual.recording import Array
from residual.robot.dynamics import PER_LINK
from residual.robot.robot import Robot

# Starts at exact values, as in a simulation: with 1 % as the finest step, one link a tenth
# off would make all others look rough, and none could be named.
SCALES = (0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 10.0)  # the last is practically free
# The same for the search of names: beyond three times its size a parameter follows the
# noise of a short log rather than the body (docs/method.md).
OF_NAMES = (*SCALES[:-1], 3.0)
# Accuracy of values of one kind, given or assumed: estimated from all joints.
WIDTHS = (0.001, 0.003, 0.01, 0.03, GIVEN, 0.3, ASSUMED)
TINY = 1e-9
HELD = 1e6  # times a prior's precision: a thousandth of its deviation


def compute_inertial_sd(robot: Robot, scale: float = 1.0) -> Array:
    """Size of each inertial parameter, for relative priors [SI]. Shape (10 dof,).

    A link's centre is never known better than a share of 5 cm, its inertia of 1 dm
    squared times its mass, so that a zero in a URDF is not taken as exact. Parameters
    with a flaw in the file stay as uncertain at any scale.
    """
    out = []
    for body in list(robot.model.inertias)[1 : robot.dof + 1]:
        size = np.abs(body.toDynamicParameters())
        floor = body.mass * np.array([0.0] + 3 * [0.05] + 6 * [0.01])
        out.append(np.maximum(np.maximum(size, floor), 1e-4))
    for flaw in robot.flaws:
        out[flaw.joint - 1] = np.maximum(out[flaw.joint - 1], flaw.doubt / scale)
    return np.concatenate(out)


@lru_cache(maxsize=16)  # for one robot, under about twenty priors
def compute_inertial_precision(robot: Robot, scale: float = 1.0) -> Array:
    """Prior precision of the inertial parameters, to be divided by the scale squared.

    Half of a link's variance is common to its ten parameters (wrong density of a CAD
    body), half is separate. Without the common half, a wrong mass would cost ten times,
    and would be taken for a payload with false precision.

    Returns:
        Block diagonal by link. Shape (10 dof, 10 dof).
    """
    sd = compute_inertial_sd(robot, scale)
    out = np.zeros((len(sd), len(sd)))
    for i, body in enumerate(list(robot.model.inertias)[1 : robot.dof + 1]):
        own = slice(10 * i, 10 * i + 10)
        shared = body.toDynamicParameters() / sd[own]
        inner = 0.5 * np.outer(shared, shared) + 0.5 * np.eye(10)
        out[own, own] = np.linalg.inv(inner) / np.outer(sd[own], sd[own])
    out.setflags(write=False)
    return out


@dataclass(frozen=True, eq=False, slots=True)
class PriorSpace:
    """The priors to compare: a scale of the rigid part, widths of values.

    This holds for declared effects as for bodies: if the logs of all joints confirm most
    values, one that is far off is a finding, else none can be.
    """

    design: Design  # columns
    nominal: NominalModel  # the nominal model
    ladder: tuple[float, ...] = OF_NAMES  # scales to choose from by the logs

    @property
    def scales(self) -> tuple[float, ...]:
        """Scales of the rigid part."""
        return self.ladder if self.nominal.scale is None else (self.nominal.scale,)

    @property
    def even(self) -> list[dict[str, float]]:
        """Widths to compare first: as given, then one common to every kind."""
        if not self.free:
            return [dict(self.nominal.widths)]
        kinds = self.nominal.kinds
        every = [kinds, *(dict.fromkeys(kinds, width) for width in WIDTHS)]
        return [w for i, w in enumerate(every) if w not in every[:i]]

    @property
    def free(self) -> bool:
        """Whether the widths are still to be chosen."""
        return self.nominal.widths is None

    def at(self, scale: float, widths: Mapping[str, float] | None) -> NominalPrior:
        """The prior of a scale and widths."""
        return build_relative_prior(self.design, self.nominal, scale, widths)

    def list_barred_effects(self, prior: NominalPrior) -> set[str]:
        """Effects that may not be named under a prior."""
        return list_forbidden_effects(prior, self.nominal)


def list_first_priors(design: Design, nominal: NominalModel) -> tuple[NominalPrior, ...]:
    """The priors to compare first: each even width at each scale, the widest last."""
    space = PriorSpace(design, nominal, SCALES)
    return tuple(space.at(s, widths) for widths in space.even for s in space.scales)


def build_relative_prior(
    design: Design, nominal: NominalModel, scale: float, widths: Mapping[str, float] | None = None
) -> NominalPrior:
    """Inertial parameters within a relative scale, declared effects as given.

    Args:
        widths: Relative sd of the declared values, by the effect's name; None for the
            given ones.
    """
    widths = nominal.kinds if widths is None else widths
    precision = np.zeros((len(design.nominal), len(design.nominal)))
    size = len(nominal.model.inertial)
    robot = nominal.model.robot
    precision[:size, :size] = compute_inertial_precision(robot, scale) / scale**2
    for link, mass in read_known_masses(robot).items():
        at = PER_LINK * link
        precision[at, at] += 1 / (EXACT * mass) ** 2
    placed = pair_coefficient_slices(nominal.model.terms, size)
    for (term, own), given in zip(placed, nominal.sd, strict=True):
        ids = design.nominal[own]
        rows = term.effect.rows(term.joints, design.dof)
        # With torque as large as the joint torque; the same under every prior, so cached.
        key = int(ids[0]), len(ids)
        if key not in design.flat:
            flat = design.unit_information(ids, rows)
            flat += 1e-6 * np.diag(np.diag(flat)) + TINY * np.eye(len(ids))
            design.flat[key] = flat
        flat = design.flat[key]
        if given is None:
            precision[own, own] = flat
        else:
            width = widths[term.effect.name]
            sd = width * np.abs(term.theta) + 1e-3 / np.sqrt(np.diag(flat))
            precision[own, own] = np.diag(1 / sd**2)
        known = select_effect_values(robot, term.effect, term.joints)
        precision[own, own] += compute_known_value_information(known, precision[own, own], True)[0]
    return _prior(precision, scale, dict(widths))


def _prior(precision: Array, scale: float, widths: Mapping[str, float]) -> NominalPrior:
    size = np.sqrt(np.diag(precision))
    log_det = 2 * np.log(size).sum()
    log_det += np.linalg.slogdet(precision / np.outer(size, size))[1]
    return NominalPrior(precision, float(log_det), scale, widths)


def list_forbidden_effects(prior: NominalPrior, nominal: NominalModel) -> set[str]:
    """Effects that may not be named under this prior.

    A declared effect is a candidate only if the logs show that values of its kind are
    accurate, a body only if the rigid part is. Otherwise their columns duplicate free
    ones, and the names would be meaningless.
    """
    out = set()
    for term, given in nominal.declared:
        settled = given is not None and prior.widths[term.effect.name] < ASSUMED
        if not (settled and EffectTrait.PARAMETER in term.effect.traits):
            out.add(term.effect.name)
    if prior.scale > THRESHOLDS.rough_scale:
        out |= {e.name for e in load_effects().values() if EffectTrait.BODY in e.traits}
    return out


def list_contradicted_coefficients(model: Model, group: CandidateColumns) -> Array:
    """Coefficients of the nominal model that an effect corrects. Shape (k,).

    All inertial ones for a body; none if the model has no such value.
    """
    if EffectTrait.PARAMETER not in group.effect.traits:
        return np.zeros(0, dtype=int)
    if EffectTrait.BODY in group.effect.traits:
        return np.arange(len(model.inertial))
    out: list[int] = []
    for term, own in pair_coefficient_slices(model.terms, len(model.inertial)):
        if term.effect.name == group.effect.name and term.joints == group.joints:
            out += range(own.start, own.stop)
    return np.array(out, dtype=int)


def hold_coefficients(prior: NominalPrior, slots: Array) -> NominalPrior:
    """Return the prior with some coefficients held at their nominal values."""
    stiff = np.zeros(len(prior.precision))
    stiff[slots] = HELD * np.diag(prior.precision)[slots]
    return replace(prior, precision=prior.precision + np.diag(stiff))


NEARLY_ALL = 0.999  # of the squares of a joint: more is rounding


def build_first_design(logs: FitLogs, nominal: NominalModel, named: Model | None = None) -> Design:
    """Build nominal columns, with features from a model that fits these logs roughly.

    Args:
        named: A model for the features instead, such as one with the findings.
    """
    design = Design(logs.tracks, nominal.model)
    if named is None:
        prior = build_relative_prior(design, nominal, THRESHOLDS.rough_scale)
        named = build_fitted_model(nominal, fit_nominal(design, prior))
    design.set_torque_model(named)
    return design


# Quick screening of every candidate at once, and its overlap with a fit.


def screen_candidates(
    design: Design, fitted: Fit, groups: Sequence[CandidateColumns], system: FitEquations
) -> Array:
    """Evidence gain of every group on top of a fit, by one projection [nats]. (g,).

    Rows count for a quarter of their number or more: optimistic, so that no relevant
    candidate is lost. With the noise of the fit the gain is a quadratic form q, at most
    half of the n rows however well a group explains them; with noise from the remaining
    residual it is -n/2 log(1 - 2 q / n). Groups of equal size are stacked.
    """
    counted = np.maximum(0.25 * design.rows, fitted.counted)
    weight = np.maximum(0.25, fitted.share) / fitted.variance
    theta, lower = system.solve(weight)
    shared = weight_column_products(design, system, weight)
    pull = weight_target_products(design, weight) - theta @ shared
    half = solve_triangular(lower, shared, lower=True, check_finite=False)
    out = np.empty(len(groups))
    for stack in stack_groups(design, groups):
        c = stack.precision + stack.beyond(weight, half)
        fall, volume = _quadratic(c, pull[stack.ids] + stack.pull)
        n = stack.acts @ counted
        share = np.clip(2 * fall / np.maximum(n, 1.0), 0.0, NEARLY_ALL)
        fall = np.maximum(fall, -0.5 * n * np.log1p(-share))
        out[stack.members] = fall + 0.5 * (stack.log_det - volume - stack.level)
    return out


def weight_target_products(design: Design, weight: Array) -> Array:
    """Weighted products of the target with all columns. Shape (size,)."""
    out = np.zeros(design.size)
    for j in range(design.dof):
        every = np.flatnonzero(design.place[j] >= 0)
        out[every] += weight[j] * design.total(j)[1][design.place[j][every]]
    return out


def weight_column_products(design: Design, system: FitEquations, weight: Array) -> Array:
    """Weighted products of a fit's columns with all columns. Shape (m, size)."""
    out = np.zeros((len(system.ids), design.size))
    for j in range(design.dof):
        rows, have = system.present[j]
        every = np.flatnonzero(design.place[j] >= 0)
        columns = design.place[j][every]
        block = design.total(j)[0][np.ix_(rows, columns)]
        out[np.ix_(have, every)] += weight[j] * block
    return out


def project_columns(design: Design, system: FitEquations, weight: Array) -> Array:
    """Projection of all columns on a fit, for `GroupStack.beyond`. (m, size)."""
    shared = weight_column_products(design, system, weight)
    return solve_triangular(system.solve(weight)[1], shared, lower=True)


@dataclass(frozen=True, eq=False, slots=True)
class GroupStack:
    """Groups with equal numbers of columns."""

    members: Array  # their numbers among all groups, (g,)
    ids: Array  # their columns, (g, k)
    gram: Array  # of each by itself, joint by joint, (dof, g, k, k)
    acts: Array  # the joints on which they act. Shape (g, dof), bool
    precision: Array  # their priors, (g, k, k)
    # Known values (``KnownPrior``), (g, k), (g,).
    pull: Array
    level: Array
    log_det: Array  # log determinants of these, (g,)

    def beyond(self, weight: Array, half: Array) -> Array:
        """Information of the groups that a fit cannot imitate. Shape (g, k, k).

        Args:
            weight: Information of a unit of squared error of each joint. Shape (dof,).
            half: Products of the columns of the fit with all, by the lower factor of
                the precision of the fit. Shape (m, size).
        """
        own = half[:, self.ids].transpose(1, 0, 2)
        known = np.tensordot(weight, self.gram, 1)
        return known - own.transpose(0, 2, 1) @ own


def stack_groups(design: Design, groups: Sequence[CandidateColumns]) -> list[GroupStack]:
    """Return groups stacked by size; cached by the design."""
    key = tuple(groups)
    if key not in design.stacks:
        alike: dict[int, list[int]] = {}
        for i, g in enumerate(groups):
            alike.setdefault(len(g.ids), []).append(i)
        design.stacks[key] = [_stack(design, groups, np.array(m)) for m in alike.values()]
    return design.stacks[key]


def _stack(design: Design, groups: Sequence[CandidateColumns], members: Array) -> GroupStack:
    own = [groups[i] for i in members]
    ids = np.stack([g.ids for g in own])
    grams = np.zeros((design.dof, *ids.shape, ids.shape[1]))
    acts = np.zeros((len(own), design.dof), dtype=bool)
    for j in range(design.dof):
        place = design.place[j][ids]
        have = place >= 0
        acts[:, j] = have.any(axis=1)
        some = np.flatnonzero(acts[:, j])
        block = design.total(j)[0][place[some][:, :, None], place[some][:, None, :]]
        grams[j, some] = block * (have[some][:, :, None] & have[some][:, None, :])
    priors = [g.prior for g in own]
    precision = np.stack([g.precision + g.prior.information for g in own])
    pull = np.stack([p.pull for p in priors])
    level, log_det = np.array([(p.level, p.log_det) for p in priors]).T
    return GroupStack(members, ids, grams, acts, precision, pull, level, log_det)


def _quadratic(c: Array, u: Array) -> tuple[Array, Array]:
    """u'c^-1 u / 2 and log det c, for stacks. Shapes (g,)."""
    size = np.sqrt(np.maximum(np.diagonal(c, axis1=1, axis2=2), 1e-300))
    if c.shape[1] == 1:
        return 0.5 * (u[:, 0] / size[:, 0]) ** 2, 2 * np.log(size[:, 0])
    scaled = c / size[:, :, None] / size[:, None, :]
    values, vectors = np.linalg.eigh(scaled)
    values = np.maximum(values, 1e-12)
    projected = np.einsum("gij,gi->gj", vectors, u / size)
    fit_part = 0.5 * np.sum(projected**2 / values, axis=1)
    return fit_part, np.log(values).sum(axis=1) + 2 * np.log(size).sum(axis=1)
