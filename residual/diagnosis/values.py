"""Which of the values that the model was given the logs bear out, and which not.

Each is asked with its own prior taken away, the others held to be as good as their kind
has proved to be: what is left is what the logs themselves say of it. With V0 and V1 its
covariance before and after, and m1 its mean, the logs alone know it by

information = V1^-1 - V0^-1,    mean = information^-1 V1^-1 m1.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from residual.diagnosis.outcome import SearchOutcome
from residual.diagnosis.uncertainty import between_logs, values_jacobian
from residual.effects.base import Effect
from residual.evidence.fit import Fit, scaled_inverse
from residual.evidence.priors import inertial_sd
from residual.evidence.thresholds import THRESHOLDS
from residual.model.model import Term, with_slots
from residual.quantity import plain
from residual.recording import Array
from residual.robot.dynamics import base_parameters
from residual.verdict.result import Change

LOOSE = 1e-4  # of the prior's information: what stays, so that nothing is infinite
BODY = "inertial"


@dataclass(frozen=True, eq=False, slots=True)
class _Values:
    """Values that are asked together: those of one joint, or one of the body."""

    # (name, joints from 1, parameter, unit) of each.
    names: tuple[tuple[str, tuple[int, ...], str, str], ...]
    nominal: Array  # their nominal values, (k,)
    size: Array  # what 5 % is taken of, (k,)
    slope: Array  # their derivative to the coefficients of the nominal model, (k, p)
    # The same to all of the fit, findings of the same thing included, (k, m).
    added: Array


def compare_values(outcome: SearchOutcome, fitted: Fit) -> tuple[Change, ...]:
    """Return every value that the model was given, and what the logs make of it."""
    groups = [*_drive_values(outcome, fitted), *_body_values(outcome, fitted)]
    count = sum(len(a.names) for a in groups)
    if not count:
        return ()
    sure = -float(ndtri(THRESHOLDS.value_change_chance / count / 2))
    state = _Covariances.of(outcome, fitted)
    return tuple(c for a in groups for c in _value_changes(state, a, sure))


@dataclass(frozen=True, eq=False, slots=True)
class _Covariances:
    """Covariances before and after the logs, and how much logs differ. Each (m, m)."""

    theta: Array
    before: Array
    after: Array
    between: Array

    @classmethod
    def of(cls, outcome: SearchOutcome, fitted: Fit) -> "_Covariances":
        task = outcome.task
        before = np.zeros((len(fitted.ids), len(fitted.ids)))
        p = len(task.design.nominal)
        before[:p, :p] = scaled_inverse(task.prior.precision)
        for g in fitted.members:
            at = fitted.slots(g)
            before[np.ix_(at, at)] = scaled_inverse(g.precision)
        return cls(
            fitted.theta, before, fitted.covariance(), between_logs(task.design, fitted)
        )


def _value_changes(
    state: _Covariances, values: _Values, sure: float
) -> Iterator[Change]:
    a, p = values.added, values.slope.shape[1]
    after = scaled_inverse(a @ state.after @ a.T)
    prior = a @ state.before @ a.T
    information = _positive_information(after - scaled_inverse(prior), prior)
    covariance = np.linalg.inv(information)
    gap = covariance @ (after @ (a @ state.theta))
    # Logs that disagree pull a value that its prior holds by less than a free one.
    freed = covariance @ after
    variance = np.diag(covariance + freed @ (a @ state.between @ a.T) @ freed.T)
    refit_gap = values.slope @ state.theta[:p]  # of the gap what no finding says
    for i, (name, joints, parameter, unit) in enumerate(values.names):
        sd = float(np.sqrt(variance[i]))
        least = max(THRESHOLDS.min_value_change * values.size[i], sure * sd)
        yield Change(
            name=name,
            joints=joints,
            parameter=parameter,
            nominal=plain(values.nominal[i]),
            identified=plain(values.nominal[i] + gap[i]),
            std=plain(sd),
            unit=unit,
            sigma=plain(gap[i] / sd),
            beyond=bool(abs(gap[i]) > least),
            explained=bool(a[i, p:].any() and abs(refit_gap[i]) < least),
        )


def _drive_values(outcome: SearchOutcome, fitted: Fit) -> list[_Values]:
    """Declared values, grouped by joints."""
    nominal = outcome.nominal
    terms, given = zip(*nominal.declared, strict=True) if nominal.declared else ((), ())
    placed = with_slots(terms, len(nominal.model.inertial))
    together: dict[tuple, list] = {}
    for (term, own), width in zip(placed, given, strict=True):
        if width is not None:
            together.setdefault(term.joints, []).append((term, own))
    robot = outcome.logs.robot
    return [_joint_values(robot, fitted, terms) for terms in together.values()]


def _joint_values(robot, fitted: Fit, terms: list[tuple[Term, slice]]) -> _Values:
    names, nominal, rows, count = [], [], [], len(fitted.ids)
    for term, slots in terms:
        effect = term.effect
        values = np.asarray(effect.values(term.theta, term.shape, robot), dtype=float)
        jacobian = values_jacobian(effect, term.theta, term.shape, robot)
        finding_slots = _findings_of(fitted, effect, term)
        for i, (key, unit) in enumerate(effect.units(term.joints, robot).items()):
            if not jacobian[i].any():
                continue  # of the shape, which is not refitted
            row = np.zeros(count)
            row[slots] = jacobian[i]
            for more in finding_slots:
                row[more] = jacobian[i]
            joints = tuple(j + 1 for j in term.joints)
            names.append((effect.name, joints, key, unit))
            nominal.append(values[i])
            rows.append(row)
    added = np.array(rows)
    slope = _without_findings(added, fitted)
    nominal = np.array(nominal)
    return _Values(tuple(names), nominal, np.abs(nominal), slope, added)


def _findings_of(fitted: Fit, effect: Effect, term: Term) -> list[Array]:
    return [
        fitted.slots(g)
        for g in fitted.members
        if g.effect.name == effect.name
        and g.joints == term.joints
        and g.shape == term.shape
    ]


def _body_values(outcome: SearchOutcome, fitted: Fit) -> list[_Values]:
    """Identifiable base parameters of the arm's bodies, one by one."""
    robot = outcome.logs.robot
    base = base_parameters(robot.model)
    inertial = outcome.nominal.model.inertial
    size = np.sqrt(base.mapping**2 @ inertial_sd(robot) ** 2)
    added = np.zeros((len(base), len(fitted.ids)))
    added[:, : len(inertial)] = base.mapping
    for g in fitted.members:
        if (bodies := g.effect.portable.bodies) is not None and not g.parts:
            ways = [bodies(u, g.joints, robot) for u in np.eye(len(g.ids))]
            added[:, fitted.slots(g)] = base.mapping @ np.array(ways).T
    slope = _without_findings(added, fitted)
    nominal = base.mapping @ inertial
    return [
        _Values(
            ((BODY, (one.joint,), base.words(i), one.unit),),
            nominal[i : i + 1],
            np.maximum(np.abs(nominal[i : i + 1]), size[i]),
            slope[i : i + 1],
            added[i : i + 1],
        )
        for i, one in enumerate(base.leading)
    ]


def _without_findings(added: Array, fitted: Fit) -> Array:
    members = sum(len(g.ids) for g in fitted.members)
    return added[:, : len(fitted.ids) - members]


def _positive_information(information: Array, prior: Array) -> Array:
    """Information of the logs, floored at a ten thousandth of the prior's."""
    size = np.sqrt(np.diag(prior))
    values, vectors = np.linalg.eigh(information * np.outer(size, size))
    kept = (vectors * np.maximum(values, LOOSE)) @ vectors.T
    return kept / np.outer(size, size)
