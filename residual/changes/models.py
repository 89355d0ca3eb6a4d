"""The models of two epochs: the arm as it was, as it is, and as it was with the change.

The nominal model is the first epoch's fit with all that any arm has a little of, the
identified one the same of the second epoch, the augmented one the fit of both with what
changed.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.changes.rows import (
    CommonModelFit,
    EpochRows,
    fit_common_model,
    fit_without_changes,
)
from residual.changes.search import ChangeSearch, NamedChange
from residual.effects.base import EffectTrait
from residual.evidence.fit import (
    Fit,
    PossibleModel,
    SeparateTerm,
    build_fitted_model,
    fit_possible_bodies,
)
from residual.evidence.priors import SCALES
from residual.model.model import Model, Term, pair_coefficient_slices
from residual.model.nominal import (
    FitLogs,
    NominalModel,
    choose_standstill_behaviour,
    start_model,
)
from residual.quantity import convert_to_plain_values
from residual.recording import Array
from residual.verdict.result import Change

SURE = 3.0  # deviations beyond which a value has changed
LEAST = 0.05  # of a value: less is no news


@dataclass(frozen=True, eq=False, slots=True)
class EpochFit:
    """One epoch's fit."""

    logs: FitLogs  # its logs
    model: Model  # the model that came out
    joint: CommonModelFit  # the fit behind it


def fit_epoch(
    logs: FitLogs, nominal: NominalModel, like: Model | None = None
) -> EpochFit:
    """Fit the logs of one epoch.

    Args:
        like: An earlier epoch's, to begin with: what these logs do not show is as it
            was, and so is how the arm stands.
    """
    start = start_model(logs, nominal.model if like is None else like)
    nominal = replace(nominal, model=start)
    joint = fit_common_model(logs, nominal, SCALES)
    rough = build_fitted_model(nominal, joint.fitted)
    rough = fit_possible_bodies(joint.design, joint.fitted, rough).model
    if like is None:
        # What brakes decides how a joint stands; the rest only takes time.
        kept = [t for t in rough.terms if _brakes(t) or t.effect.carries]
        still = choose_standstill_behaviour(
            replace(rough, terms=tuple(kept)), logs.sketch
        )
        rough = replace(rough, standstill=still.standstill)
    return EpochFit(logs, _with_tables(rough, nominal), joint)


def _brakes(term: Term) -> bool:
    return EffectTrait.FRICTION in term.effect.traits


def _merge_terms(terms: Sequence[Term]) -> tuple[Term, ...]:
    """Add up terms of one effect, place and shape."""
    out: dict[tuple, Term] = {}
    for term in terms:
        key = term.effect.name, term.joints, term.shape
        known_term = out.get(key)
        out[key] = (
            term
            if known_term is None
            else replace(known_term, theta=known_term.theta + term.theta)
        )
    return tuple(out.values())


def build_augmented_model(
    search: ChangeSearch, nominal: NominalModel, like: Model
) -> PossibleModel:
    """The arm of both epochs, with what changed: warmth of all joints included.

    What did not change is fitted to both epochs, the second less what did: either
    epoch alone knows less of it.
    """
    both, changed = search.both, build_changed_terms(search)
    groups = [(c.contrast.candidate.group, c.contrast.theta) for c in search.changes]
    design, fitted, changed_torque = fit_without_changes(both, groups)
    rough = build_fitted_model(nominal, fitted)
    full_model = replace(rough, terms=(*rough.terms, *changed))
    possible = fit_possible_bodies(
        design, fitted, full_model, [_separate_term(both, c) for c in search.changes]
    )
    terms, count = possible.model.terms, len(rough.terms)
    rough, changed = replace(possible.model, terms=terms[:count]), terms[count:]
    model = replace(_with_tables(rough, nominal), standstill=like.standstill)
    if search.warmth.significant:
        factor = 1.0 + _friction_factors(search, fitted, changed_torque)
        model = replace(
            model,
            terms=_scale_friction(model.terms, factor),
            tables=_scale_friction(model.tables, factor),
        )
    return replace(possible, model=replace(model, terms=(*model.terms, *changed)))


def _separate_term(both: EpochRows, change: NamedChange) -> SeparateTerm:
    """A change as a term on the rows of the second epoch."""
    group, design = change.contrast.candidate.group, both.design
    columns = []
    for j, layout in enumerate(both.layout):
        place, have = design.present(j, group.ids)
        own = np.zeros((len(layout.second), len(group.ids)))
        own[:, have] = layout.second[:, None] * design.columns(j, place)
        columns.append(own)
    return SeparateTerm(change.contrast.covariance, tuple(columns))


def _scale_friction(terms: Sequence[Term], factor: Array) -> tuple[Term, ...]:
    return tuple(
        replace(t, theta=factor[t.joints[0]] * t.theta) if _brakes(t) else t
        for t in terms
    )


def _friction_factors(
    search: ChangeSearch, fitted: Fit, changed_torque: Sequence[Array]
) -> Array:
    """Friction of the second epoch over the joint fit's, less one. Shape (dof,).

    The joint fit lies between the epochs, by how much of each there is; from what all
    joints have in common each differs as much as its rows say.
    """
    both, warm, design = search.both, search.warmth, search.both.design
    rows = np.concatenate([own.second for own in both.layout])
    common = warm.factor * float(1 - rows.mean())
    out = np.full(design.dof, common)
    for j in search.table.joints:
        second = both.layout[j].second
        residual = (
            design.residual(j, fitted.ids, fitted.theta)[second]
            - changed_torque[j][second]
        )
        f = both.friction[j][second]
        weight = search.table.noise.weight[j]
        prior_weight = 1 / warm.per_joint[j] ** 2
        out[j] = (prior_weight * common + weight * (f @ residual)) / (
            prior_weight + weight * (f @ f)
        )
    return out


def _with_tables(rough: Model, nominal: NominalModel) -> Model:
    """Move the effects that any arm has into the model's tables, without names."""
    start = nominal.model
    count = len(start.terms)
    terms = tuple(term.as_nominal() for term in rough.terms[:count])
    tables = _merge_terms((*start.tables, *rough.terms[count:]))
    return replace(rough, terms=terms, tables=tables)


def build_changed_terms(search: ChangeSearch) -> tuple[Term, ...]:
    """What changed, as terms of a model."""
    out = []
    for change in search.changes:
        group, theta = change.contrast.candidate.group, change.contrast.theta
        out.append(Term(group.effect, group.joints, group.shape, theta))
    return tuple(out)


def compare_epoch_values(
    first: EpochFit, second: EpochFit, search: ChangeSearch
) -> Iterator[Change]:
    """Declared values of separate fits of both epochs, with both deviations.

    Two fits may share out the same friction otherwise. So a value is off only where the
    comparison of both epochs says so too.
    """
    named = {(c.group.effect.name, c.group.joints) for c in search.named}
    size = len(first.model.inertial)
    placed = list(pair_coefficient_slices(first.model.terms, size))
    before, after = _covariance(first), _covariance(second)
    for (term, own), now in zip(placed, second.model.terms, strict=True):
        effect, robot = term.effect, first.model.robot
        old_values = effect.values(term.theta, term.shape, robot)
        new_values = effect.values(now.theta, now.shape, robot)
        slope = _slope(term, robot)
        spread = before[own, own] + after[own, own]
        sd = np.sqrt(np.diag(slope @ spread @ slope.T))
        for i, (key, unit) in enumerate(effect.units(term.joints, robot).items()):
            gap = float(new_values[i] - old_values[i])
            sigma = abs(gap) / sd[i] if sd[i] > 0 else None
            beyond = (effect.name, term.joints) in named
            beyond = beyond and sigma is not None and sigma > SURE
            yield Change(
                name=effect.name,
                joints=tuple(j + 1 for j in term.joints),
                parameter=key,
                nominal=convert_to_plain_values(float(old_values[i])),
                identified=convert_to_plain_values(float(new_values[i])),
                std=convert_to_plain_values(float(sd[i])),
                unit=unit,
                sigma=convert_to_plain_values(sigma),
                beyond=bool(beyond and abs(gap) > LEAST * abs(old_values[i])),
            )


def _covariance(epoch: EpochFit) -> Array:
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
