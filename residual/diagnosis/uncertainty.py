"""Standard deviations of what is reported: noise, logs that disagree, other forms."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag
from scipy.special import ndtri, stdtrit

from residual.diagnosis.outcome import SearchOutcome
from residual.diagnosis.search import refine_shape
from residual.effects.base import Effect, PlacedEffect, Shape, Trait
from residual.evidence.design import Design, Group
from residual.evidence.fit import (
    Fit,
    Prior,
    chance_of,
    fit,
    scaled_inverse,
)
from residual.evidence.priors import OF_NAMES, PriorSpace
from residual.recording import Array
from residual.robot.robot import Robot

FLAT = 1e-9  # of the largest correlation: a direction that moves nothing
USUAL = 0.975  # quantile at two standard deviations
STEP = 1e-3  # relative step of the numerical derivatives


@dataclass(frozen=True, eq=False, slots=True)
class Uncertainty:
    """How well a member is known."""

    std: Array  # standard deviation of each parameter, (parameters,)
    prior: Array  # the same before the logs spoke, (parameters,)
    theta: Array  # standard deviation of each coefficient, and before, (2, k)
    # Chance of coefficients so far from zero if they were zero, and the rest as good as
    # the logs say.
    chance: float


def standard_deviations(
    outcome: SearchOutcome, fitted: Fit, sizes: Mapping[Group, tuple[Array, Array]]
) -> dict[Group, Uncertainty]:
    """Standard deviation of every parameter of every member.

    The largest of three: by the noise, by how much logs disagree, and by other forms of
    the effect. A searched shape is uncertain too: its derivative columns join the fit
    (Gauss-Newton), and the parameters' covariance follows by linearisation.

    Args:
        sizes: For each member its coefficients and what is doubtful of them
            beside the noise. Shapes (k,), (k, k).

    Returns:
        What is known of each member.
    """
    task, robot = outcome.task, outcome.logs.robot
    extra = {g: _slope(task.design, g, fitted.of(g)) for g in fitted.members}
    slopes = [s for s in extra.values() if s is not None]
    members = (*fitted.members, *slopes)
    known = fitted.counted, fitted.variance, 1
    full = fit(task.design, outcome.wide, members, *known)
    covariance, between = full.covariance(), between_logs(task.design, full)
    sharp = fit(task.design, doubtful(outcome), members, *known).covariance()
    out = {}
    for g in fitted.members:
        slope, (theta, doubt) = extra[g], sizes[g]
        slots = full.slots(g)
        if slope is not None:
            slots = np.concatenate([slots, full.slots(slope)])
        searched = slope is not None
        jacobian = values_jacobian(g.effect, theta, g.shape, robot, searched)
        own = [c[np.ix_(slots, slots)] for c in (covariance, between, sharp)]
        for c in own:
            c[: len(theta), : len(theta)] += doubt
        form = _form_doubt(outcome, fitted, g)
        prior = _prior_std(g, slope, jacobian)
        out[g] = _doubt(g, theta, own, jacobian, form, prior)
    return out


def doubtful(outcome: SearchOutcome) -> Prior:
    """The prior that a wrong value must stand out from: bodies one step rougher.

    Their scale is an estimate from few sums of many parameters, good to such a step.
    """
    prior, wide = outcome.task.prior, outcome.wide
    if prior.scale >= wide.scale:
        return wide
    rougher = min([s for s in OF_NAMES if s > prior.scale], default=wide.scale)
    space = PriorSpace(outcome.task.design, outcome.nominal)
    return space.at(min(rougher, wide.scale), prior.widths)


def _doubt(
    group: Group,
    theta: Array,
    own: Sequence[Array],
    jacobian: Array,
    form: Array,
    prior: Array,
) -> Uncertainty:
    """Sum up the covariances of one member: by noise, between logs, and at best."""
    by_noise, between, best = own
    wide = (by_noise, between)
    variance = [np.einsum("ij,jk,ik->i", jacobian, c, jacobian) for c in wide]
    std = np.sqrt(np.maximum.reduce([*variance, form**2]))
    k = len(theta)
    # A structure must stand out though bodies may be off by as much as logs allow;
    # that a value is wrong is asked of this value, the others as good as they are.
    least = best if Trait.PARAMETER in group.effect.traits else by_noise
    told = (least, least + between)
    chance = max(chance_of(theta, c[:k, :k], FLAT) for c in told)
    before = np.diag(scaled_inverse(group.precision))
    after = np.maximum.reduce([np.diag(c)[:k] for c in wide])
    deviations = np.sqrt(np.maximum([after, before], 0.0))
    return Uncertainty(std, prior, deviations, chance)


def _prior_std(group: Group, slope: Group | None, jacobian: Array) -> Array:
    """Standard deviation of the parameters by the prior alone. Shape (parameters,)."""
    parts = [group, *([] if slope is None else [slope])]
    blocks = [scaled_inverse(part.precision) for part in parts]
    covariance = block_diag(*blocks)
    return np.sqrt(np.einsum("ij,jk,ik->i", jacobian, covariance, jacobian))


def between_logs(design: Design, full: Fit) -> Array:
    """Covariance by how much the logs disagree on the coefficients. Shape (m, m).

    No effect has the very form of a textbook, and what is left of it pulls each log its
    own way: a sandwich of the scores of the folds (Liang & Zeger 1986). Of so few, two
    standard deviations are made to hold what Student's t holds.
    """
    weight = full.weight(design.rows)
    pulls = np.zeros((design.folds, len(full.ids)))
    for j in range(design.dof):
        place, have = design.present(j, full.ids)
        gram, cross = design.fold_sums(j, place)
        left = cross - gram @ full.theta[have]
        pulls[:, have] += weight[j] * left
    pulls -= pulls.mean(axis=0)  # the prior's own pull is shared by all
    moved = pulls @ full.covariance()
    free = max(design.folds - 1, 1)
    wider = float(stdtrit(free, USUAL) / ndtri(USUAL))
    return wider**2 * design.folds / free * moved.T @ moved


def _form_doubt(outcome: SearchOutcome, fitted: Fit, group: Group) -> Array:
    """Half of what another form of the same effect would change. Shape (parameters,).

    Stribeck's curve falls as exp(-x) in one textbook and as exp(-x^2) in another: what
    logs hold of it does not reach down to standstill, where its level is said.
    """
    task, effect = outcome.task, group.effect
    robot = outcome.logs.robot
    own = np.asarray(effect.values(fitted.of(group), group.shape, robot), dtype=float)
    anchor = group.joints[0] if group.joints else 0
    forms = {shape[1:] for shape in effect.shapes(outcome.logs.span, anchor)}
    units = np.array(list(effect.parameters.values()))
    sizes = [np.linalg.norm(own[units == unit]) for unit in units]
    doubt = effect.inexact * np.array(sizes)
    for form in sorted(forms - {group.shape[1:]}):
        shape = (group.shape[0], *form)
        made = task.design.add([group.placed._replace(shape=shape)])
        rest = [g for g in fitted.members if g is not group]
        *_, best = refine_shape(task, (*rest, *made), fitted)
        theta = task.fit((*rest, best), fitted).of(best)
        doubt = np.maximum(
            doubt, abs(effect.values(theta, best.shape, robot) - own) / 2
        )
    return doubt


def _slope(design: Design, group: Group, theta: Array) -> Group | None:
    """Column of the derivative to the searched shape, as a group of its own."""
    effect = group.effect
    if effect.refine is None:
        return None
    x, rest = group.shape[0], group.shape[1:]
    step = STEP * abs(x)

    def columns(state, joints, shape):
        above = effect.columns(state, joints, (x + step, *rest))
        below = effect.columns(state, joints, (x - step, *rest))
        return ((above - below) @ theta / (2 * step))[:, :, None]

    derivative = Effect(effect.name, "", {}, columns, scope=effect.scope)
    (made,) = design.add([PlacedEffect(derivative, group.joints, ())])
    # The search was confined to the shape's own scale: 100 % of it, one sigma.
    width = abs(x)
    return Group(
        derivative, group.joints, (), made.ids, np.eye(1) / width**2, -2 * np.log(width)
    )


def values_jacobian(
    effect: Effect, theta: Array, shape: Shape, robot: Robot, with_shape: bool = False
) -> Array:
    """Derivative of an effect's parameter values to its coefficients.

    Args:
        theta: Its coefficients. Shape (k,).
        shape: Its shape.
        with_shape: Whether the first number of the shape comes last.

    Returns:
        Shape (parameters, k) or (parameters, k + 1).
    """
    start = np.concatenate([theta, shape[:1] if with_shape else []])

    def values(x: Array) -> Array:
        at = (x[-1], *shape[1:]) if with_shape else shape
        return np.asarray(effect.values(x[: len(theta)], at, robot), dtype=float)

    columns = []
    for i, x in enumerate(start):
        step = STEP * max(abs(x), 1e-6)
        shift = np.eye(len(start))[i] * step
        columns.append((values(start + shift) - values(start - shift)) / (2 * step))
    return np.column_stack(columns)
