"""The models of two epochs: the arm as it was, as it is, and as it was with the change.

The nominal model is the first epoch's fit with all that any arm has a little of, the
identified one the same of the second epoch, the augmented one the first epoch's with
what changed.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.diagnosis.causes.change import Change
from residual.epochs.rows import JointFit, joint_fit
from residual.epochs.search import Found
from residual.evidence.priors import SCALES
from residual.evidence.states import as_model
from residual.model.model import Model
from residual.model.nominal import Logs, Nominal, begin
from residual.model.standstill import with_standstill
from residual.model.term import Term, with_slots
from residual.plain import plain
from residual.recording import Array

SURE = 3.0  # deviations beyond which a value has changed
LEAST = 0.05  # of a value: less is no news


@dataclass(frozen=True, eq=False, slots=True)
class Epoch:
    """One epoch's fit.

    Attributes:
        logs: Its logs.
        model: The model that came out.
        joint: The fit behind it.
    """

    logs: Logs
    model: Model
    joint: JointFit


def fit_epoch(logs: Logs, nominal: Nominal, like: Model | None = None) -> Epoch:
    """Fit the logs of one epoch.

    Args:
        logs: The logs.
        nominal: The model that the arm is said to have.
        like: An earlier epoch's, to begin with: what these logs do not show is as it
            was, and so is how the arm stands.
    """
    start = begin(logs, nominal.model if like is None else like)
    nominal = replace(nominal, model=start)
    joint = joint_fit(logs, nominal, SCALES)
    rough = as_model(nominal, joint.fitted)
    if like is None:
        # What brakes decides how a joint stands; the rest only takes time.
        kept = [t for t in rough.terms if t.effect.brakes or t.effect.carries]
        still = with_standstill(replace(rough, terms=tuple(kept)), logs.sketch)
        rough = replace(rough, standstill=still.standstill)
    # What any arm has a little of is a part of its model, and has no name there.
    count = len(start.terms)
    terms = tuple(term.as_nominal() for term in rough.terms[:count])
    tables = _together((*start.tables, *rough.terms[count:]))
    return Epoch(logs, replace(rough, terms=terms, tables=tables), joint)


def _together(terms: Sequence[Term]) -> tuple[Term, ...]:
    """Terms of one effect, place and shape as one."""
    out: dict[tuple, Term] = {}
    for term in terms:
        key = term.effect.name, term.joints, term.shape
        old = out.get(key)
        out[key] = term if old is None else replace(old, theta=old.theta + term.theta)
    return tuple(out.values())


def augmented(first: Model, found: Found) -> Model:
    """The first epoch's model with what changed, warmth of all joints included."""
    factor = 1.0 + (found.warmth.factor if found.warmth.told else 0.0)

    def warm(terms: Sequence[Term]) -> tuple[Term, ...]:
        return tuple(
            replace(t, theta=factor * t.theta) if t.effect.brakes else t for t in terms
        )

    terms = (*warm(first.terms), *changed_terms(found))
    return replace(first, terms=terms, tables=warm(first.tables))


def changed_terms(found: Found) -> tuple[Term, ...]:
    """What changed, as terms of a model."""
    out = []
    for change in found.changes:
        group, theta = change.contrast.candidate.group, change.contrast.theta
        out.append(Term(group.effect, group.joints, group.shape, theta))
    return tuple(out)


def values_that_changed(first: Epoch, second: Epoch) -> Iterator[Change]:
    """Declared values of separate fits of both epochs, with both deviations.

    Args:
        first: Fit of the first epoch.
        second: Fit of the second.
    """
    size = len(first.model.inertial)
    placed = list(with_slots(first.model.terms, size))
    before, after = _known(first), _known(second)
    for (term, own), now in zip(placed, second.model.terms, strict=True):
        effect, robot = term.effect, first.model.robot
        old = effect.values(term.theta, term.shape, robot)
        new = effect.values(now.theta, now.shape, robot)
        slope = _slope(term, robot)
        spread = before[own, own] + after[own, own]
        sd = np.sqrt(np.diag(slope @ spread @ slope.T))
        for i, (key, unit) in enumerate(effect.parameters.items()):
            gap = float(new[i] - old[i])
            sigma = abs(gap) / sd[i] if sd[i] > 0 else None
            beyond = sigma is not None and sigma > SURE
            yield Change(
                name=effect.name,
                joints=tuple(j + 1 for j in term.joints),
                parameter=key,
                nominal=plain(float(old[i])),
                identified=plain(float(new[i])),
                std=plain(float(sd[i])),
                unit=unit,
                sigma=plain(sigma),
                beyond=bool(beyond and abs(gap) > LEAST * abs(old[i])),
            )


def _known(epoch: Epoch) -> Array:
    return epoch.joint.fitted.covariance()


def _slope(term: Term, robot) -> Array:
    """Derivative of an effect's values to its coefficients. (parameters, k)."""
    effect, count = term.effect, len(term.theta)
    at = effect.values(term.theta, term.shape, robot)
    step = 1e-4 * max(float(np.abs(term.theta).max(initial=0.0)), 1e-4)
    ways = [
        effect.values(term.theta + step * one, term.shape, robot)
        for one in np.eye(count)
    ]
    return (np.column_stack(ways) - np.asarray(at)[:, None]) / step
