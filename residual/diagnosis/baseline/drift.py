"""Friction that moved on all joints together since the baseline: warmth, wear, time.

Grease that is warmer takes friction off every joint at once, of some more and of some
less. Held to the baseline's own values, every joint would get a name of its own.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from residual.diagnosis.drift import Drift
from residual.effects import registry
from residual.evidence.design import Design
from residual.evidence.fit import Fit, fit, start
from residual.evidence.priors import priors
from residual.model.model import Model
from residual.model.nominal import Logs, Nominal
from residual.model.term import Term
from residual.recording import Array

COMMON = 0.3  # relative deviation of a change that all friction shares
LOOSE = 0.5  # the same of each joint by itself, when it is asked how much it moved
LEAST, MOST = 0.01, 0.15  # what a joint may differ from the others by
FEW = 4  # joints under which their scatter says nothing
USUAL = 0.5  # of the common change: what a joint differs by then
WORTH = 10.0  # nats that fading must gain, as a name must
FADES = 0.2  # relative deviation of what fades during the session
HALF = 0.5  # of the joints must have moved that way, or it is no common change
SURE, TELLS = 3.0, 2.0  # deviations, of the common change and of one joint's
MAD = 1.4826  # times the median deviation is a normal one


def free_to_drift(nominal: Nominal, logs: Logs) -> Nominal:
    """Let the friction of a learnt model drift as these logs say that it did.

    All joints may change alike, and fade alike during the session. How much one may
    differ is read off their scatter by its median, so that a joint whose friction
    really changed does not make it usual.

    Args:
        nominal: What the baseline taught.
        logs: The logs to be held against it.
    """
    parts = _friction(nominal.model)
    if not parts:
        return nominal
    design = _design(logs, nominal.model)
    moved, sure = _moved(design, nominal, parts)
    own = _own_scatter(moved, sure)
    wider = nominal.covariance + _spread(nominal.model, parts, COMMON, own)
    drifting = replace(nominal, covariance=wider)
    levels = _levels(design, nominal.model)
    fading = _free_to_fade(drifting, logs, levels, own)
    return fading if _fades(logs, design, drifting, fading) else drifting


@dataclass(frozen=True, slots=True)
class _Part:
    """Where a friction term's coefficients stand, and on which joint it acts."""

    joint: int
    at: slice


def _friction(model: Model) -> list[_Part]:
    out, start_ = [], len(model.inertial)
    for term in model.terms:
        stop = start_ + len(term.theta)
        if term.effect.brakes and len(term.joints) == 1:
            out.append(_Part(term.joints[0], slice(start_, stop)))
        start_ = stop
    return out


def _design(logs: Logs, model: Model) -> Design:
    return Design(logs.tracks, model)


def _spread(model: Model, parts: Sequence[_Part], common: float, own: float) -> Array:
    """Covariance of friction that changes alike, by joint, and by coefficient."""
    values = model.coefficients()
    size, joints = len(values), {p.joint for p in parts}
    together, out = np.zeros(size), np.zeros((size, size))
    for joint in joints:
        alone = np.zeros(size)
        for part in parts:
            if part.joint == joint:
                alone[part.at] = values[part.at]
        together += alone
        out += own**2 * np.outer(alone, alone)
        out += (own / 2) ** 2 * np.diag(alone**2)
    return out + common**2 * np.outer(together, together)


def change_of_each(nominal: Nominal, logs: Logs, loose: float) -> tuple[Array, Array]:
    """Return how much the friction of each joint differs from its model in some logs.

    Args:
        nominal: The model, with the covariance of all that is not asked about.
        logs: The logs.
        loose: Relative deviation that a joint's friction is given.

    Returns:
        Relative change and its standard deviation; NaN without friction or motion.
        Shapes (dof,), (dof,).
    """
    parts = _friction(nominal.model)
    return _moved(_design(logs, nominal.model), nominal, parts, loose)


def _moved(
    design: Design, nominal: Nominal, parts: Sequence[_Part], own: float = LOOSE
) -> tuple[Array, Array]:
    """Relative change of each joint's friction, and its deviation. (dof,), (dof,)."""
    loose = nominal.covariance + _spread(nominal.model, parts, 0.0, own)
    (prior,) = priors(design, replace(nominal, covariance=loose))
    return changes(design, nominal.model, start(design, prior))


def changes(design: Design, model: Model, fitted: Fit) -> tuple[Array, Array]:
    """How much more of the model's friction torque each joint has, by a fit.

    Args:
        design: Columns of the logs.
        model: The model that the fit started from.
        fitted: The fit.

    Returns:
        Relative change and its standard deviation; NaN without friction or motion.
        Shapes (dof,), (dof,).
    """
    values, covariance = model.coefficients(), fitted.covariance()
    change, sure = np.full((2, design.dof), np.nan)
    for j, slots, gram in _frictions(design, model):
        share = gram @ values[slots]
        power = values[slots] @ share
        if power > 0:
            share = share / power
            change[j] = share @ fitted.theta[slots]
            sure[j] = np.sqrt(share @ covariance[np.ix_(slots, slots)] @ share)
    return change, sure


def _frictions(design: Design, model: Model) -> Iterator[tuple[int, Array, Array]]:
    """Each joint with friction, where its coefficients stand, and their Gram."""
    parts = _friction(model)
    for j in range(design.dof):
        mine = [np.r_[p.at] for p in parts if p.joint == j]
        if mine:
            slots = np.concatenate(mine)
            place, _ = design.present(j, design.nominal[slots])
            yield j, slots, design.total(j)[0][np.ix_(place, place)]


def drifted(
    design: Design, nominal: Nominal, fitted: Fit, clock: str
) -> tuple[Drift | None, float | None]:
    """Tell a change of friction that joints share.

    Joints whose friction has a name of its own have no say.

    Args:
        design: Columns of the logs.
        nominal: What the baseline taught.
        fitted: The fit that stands.
        clock: Which clock baseline and logs have in common.

    Returns:
        The drift, None where there is none; and how much of it would be told in half
        of the draws of the noise, None where none can be.
    """
    change, sure = changes(design, nominal.model, fitted)
    named = [j for g in fitted.members if g.effect.brakes for j in g.joints]
    change[named] = np.nan
    known = np.flatnonzero(np.isfinite(change))
    if len(known) < 2:
        return None, None
    weight = 1 / (sure[known] ** 2 + _own_scatter(change, sure) ** 2)
    common, std = weight @ change[known] / weight.sum(), weight.sum() ** -0.5
    least = float(max(SURE * std, LEAST))
    along = np.sign(common) * change[known] > TELLS * sure[known]
    if abs(common) < least or along.mean() < HALF:
        return None, least
    joints = tuple(int(j) + 1 for j in known[along])
    return Drift(float(1 + common), float(std), joints, clock), least


def _own_scatter(moved: Array, sure: Array) -> float:
    """What one joint's friction may change by beside the others'."""
    known = np.isfinite(moved)
    count = int(known.sum())
    if count < FEW:
        usual = np.sort(np.abs(moved[known]))[: (count + 1) // 2]
        size = USUAL * np.max(usual, initial=0.0)
    else:
        gaps = np.abs(moved[known] - np.median(moved[known]))
        noise = np.median(sure[known])
        size = np.sqrt(max((MAD * np.median(gaps)) ** 2 - noise**2, 0.0))
    return float(np.clip(size, LEAST, MOST))


def _fades(logs: Logs, design: Design, drifting: Nominal, fading: Nominal) -> bool:
    """Whether friction that fades with the session is worth its terms on these logs.

    A model that has them cannot tell the torque of a single state any more.
    """
    if not fading.fading:
        return False
    wider = _design(logs, fading.model)
    (prior,) = priors(wider, fading)
    with_it = start(wider, prior)
    (prior,) = priors(design, drifting)
    counted, variance = with_it.counted, with_it.variance
    without = fit(design, prior, (), counted, variance, rounds=4)
    return with_it.score - without.score > WORTH


def _levels(design: Design, model: Model) -> Array:
    """Rms friction torque of each joint on its rows [N m]. Shape (dof,)."""
    values, out = model.coefficients(), np.zeros(design.dof)
    for j, slots, gram in _frictions(design, model):
        power = values[slots] @ gram @ values[slots] / design.rows[j]
        out[j] = np.sqrt(max(power, 0.0))
    return out


def _free_to_fade(nominal: Nominal, logs: Logs, levels: Array, own: float) -> Nominal:
    """Add friction that fades with the session, on all joints alike, of size zero."""
    kinds = [e for e in registry().values() if e.needs_clock and e.brakes]
    joints = np.flatnonzero(levels > 0)
    if logs.clock is None or not kinds or not len(joints):
        return nominal
    shapes = kinds[0].shapes(logs.span, 0)
    if not shapes:
        return nominal
    shape = shapes[len(shapes) // 2]
    none = np.zeros(1)
    terms = [Term(kinds[0], (int(j),), shape, none).as_nominal() for j in joints]
    size = levels[joints]
    alone = max(own, USUAL * FADES)  # each joint has a heat of its own
    spread = FADES**2 * np.outer(size, size) + alone**2 * np.diag(size**2)
    return replace(
        nominal,
        model=replace(nominal.model, terms=(*nominal.model.terms, *terms)),
        given=(*nominal.given, *(None for _ in terms)),
        covariance=block_diag(nominal.covariance, spread),
        fading=len(terms),
    )
