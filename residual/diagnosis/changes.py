"""Which of the values that the model was given the logs bear out, and which not.

Each is asked with its own prior taken away, the others held to be as good as their kind
has proved to be: what is left is what the logs themselves say of it. With V0 and V1 its
covariance before and after, and m1 its mean, the logs alone know it by

information = V1^-1 - V0^-1,    mean = information^-1 V1^-1 m1.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.special import ndtri

from residual.diagnosis.angle_noise import between_logs, values_jacobian
from residual.diagnosis.examine import Examined
from residual.diagnosis.result import Change, Edit, Number
from residual.effects import registry
from residual.effects.base import Effect
from residual.evidence.design import Design
from residual.evidence.fit import Fit, scaled_inverse, smallest_change
from residual.evidence.priors import inertial_sd
from residual.evidence.rules import RULES
from residual.model.compare import compare, prepare_held_out
from residual.model.model import Model, Term, with_slots
from residual.model.nominal import prepare_logs
from residual.quantity import plain
from residual.recording import Array, Recording
from residual.robot.base_parameters import base_parameters
from residual.signals.splitting import session_clock

LOOSE = 1e-4  # of the prior's information: what stays, so that nothing is infinite
BODY = "inertial"


@dataclass(frozen=True, eq=False, slots=True)
class _Asked:
    """Values that are asked together: those of one joint, or one of the body."""

    # (name, joints from 1, parameter, unit) of each.
    names: tuple[tuple[str, tuple[int, ...], str, str], ...]
    nominal: Array  # their nominal values, (k,)
    size: Array  # what 5 % is taken of, (k,)
    slope: Array  # their derivative to the coefficients of the nominal model, (k, p)
    # The same to all of the fit, findings of the same thing included, (k, m).
    added: Array


def changes(examined: Examined, fitted: Fit) -> tuple[Change, ...]:
    """Return every value that the model was given, and what the logs make of it."""
    asked = [*_drives(examined, fitted), *_bodies(examined, fitted)]
    every = sum(len(a.names) for a in asked)
    if not every:
        return ()
    sure = -float(ndtri(RULES.change_chance / every / 2))
    state = _State.of(examined, fitted)
    return tuple(c for a in asked for c in _told(state, a, sure))


@dataclass(frozen=True, eq=False, slots=True)
class _State:
    """Covariances before and after the logs, and how much logs differ. Each (m, m)."""

    theta: Array
    before: Array
    after: Array
    between: Array

    @classmethod
    def of(cls, examined: Examined, fitted: Fit) -> "_State":
        task = examined.task
        before = np.zeros((len(fitted.ids), len(fitted.ids)))
        p = len(task.design.nominal)
        before[:p, :p] = scaled_inverse(task.prior.precision)
        for g in fitted.members:
            at = fitted.slots(g)
            before[np.ix_(at, at)] = scaled_inverse(g.precision)
        return cls(
            fitted.theta,
            before,
            fitted.covariance(),
            between_logs(task.design, fitted),
        )


def _told(state: _State, asked: _Asked, sure: float) -> Iterator[Change]:
    a, p = asked.added, asked.slope.shape[1]
    after = scaled_inverse(a @ state.after @ a.T)
    prior = a @ state.before @ a.T
    information = _positive(after - scaled_inverse(prior), prior)
    covariance = np.linalg.inv(information)
    gap = covariance @ (after @ (a @ state.theta))
    # Logs that disagree pull a value that its prior holds by less than a free one.
    freed = covariance @ after
    variance = np.diag(covariance + freed @ (a @ state.between @ a.T) @ freed.T)
    own = asked.slope @ state.theta[:p]  # of the gap what no finding says
    for i, (name, joints, parameter, unit) in enumerate(asked.names):
        sd = float(np.sqrt(variance[i]))
        least = max(RULES.least_change * asked.size[i], sure * sd)
        yield Change(
            name=name,
            joints=joints,
            parameter=parameter,
            nominal=plain(asked.nominal[i]),
            identified=plain(asked.nominal[i] + gap[i]),
            std=plain(sd),
            unit=unit,
            sigma=plain(gap[i] / sd),
            beyond=bool(abs(gap[i]) > least),
            explained=bool(a[i, p:].any() and abs(own[i]) < least),
        )


def _drives(examined: Examined, fitted: Fit) -> list[_Asked]:
    """Declared values, those of the same joints together."""
    nominal = examined.nominal
    terms, given = zip(*nominal.declared, strict=True) if nominal.declared else ((), ())
    placed = with_slots(terms, len(nominal.model.inertial))
    together: dict[tuple, list] = {}
    for (term, own), width in zip(placed, given, strict=True):
        if width is not None:
            together.setdefault(term.joints, []).append((term, own))
    robot = examined.logs.robot
    return [_of_joint(robot, fitted, terms) for terms in together.values()]


def _of_joint(robot, fitted: Fit, terms: list[tuple[Term, slice]]) -> _Asked:
    names, nominal, rows, count = [], [], [], len(fitted.ids)
    for term, own in terms:
        effect = term.effect
        values = np.asarray(effect.values(term.theta, term.shape, robot), dtype=float)
        jacobian = values_jacobian(effect, term.theta, term.shape, robot)
        same = _findings_of(fitted, effect, term)
        for i, (key, unit) in enumerate(effect.units(term.joints, robot).items()):
            if not jacobian[i].any():
                continue  # of the shape, which is not refitted
            row = np.zeros(count)
            row[own] = jacobian[i]
            for slots in same:
                row[slots] = jacobian[i]
            joints = tuple(j + 1 for j in term.joints)
            names.append((effect.name, joints, key, unit))
            nominal.append(values[i])
            rows.append(row)
    added = np.array(rows)
    slope = _without_findings(added, fitted)
    nominal = np.array(nominal)
    return _Asked(tuple(names), nominal, np.abs(nominal), slope, added)


def _findings_of(fitted: Fit, effect: Effect, term: Term) -> list[Array]:
    return [
        fitted.slots(g)
        for g in fitted.members
        if g.effect.name == effect.name
        and g.joints == term.joints
        and g.shape == term.shape
    ]


def _bodies(examined: Examined, fitted: Fit) -> list[_Asked]:
    """What the motion of the arm can tell of its body at all, sum by sum."""
    robot = examined.logs.robot
    base = base_parameters(robot.model)
    inertial = examined.nominal.model.inertial
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
        _Asked(
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


def _positive(information: Array, prior: Array) -> Array:
    """What the logs know, and a ten thousandth of the prior where they know nothing."""
    size = np.sqrt(np.diag(prior))
    values, vectors = np.linalg.eigh(information * np.outer(size, size))
    kept = (vectors * np.maximum(values, LOOSE)) @ vectors.T
    return kept / np.outer(size, size)


ROUNDS = 3  # of parameters and noise in turn


# Dense least squares: what one does without looking for a cause.
#
# All inertial parameters of all bodies and all declared coefficients are fitted freely,
# without a prior: by least squares weighted with the noise of each joint, on the very
# rows of the diagnosis (joints that move, both sides through its filter). Of the many
# parameters that fit alike (the base parameters are fewer) those nearest to the nominal
# ones are taken, in units of the torque that each makes: the mildest choice, under
# which a body that need not change does not.
#
# An effect is taken out of it by setting the parameters that stand for it back to the
# nominal model's: of a load those of the last body, of a link its own, of declared
# friction or a rotor the coefficient. Nothing is refitted then either.


def dense_model(nominal: Model, recordings: Sequence[Recording]) -> Model:
    """Fit all that the nominal model has, freely."""
    clock = session_clock(recordings)
    logs = prepare_logs(nominal.robot, recordings, clock, nominal.filters)
    return dense_fit(Design(logs.tracks, nominal))


def dense_fit(design: Design) -> Model:
    """Fit all that a design's nominal model has, freely, on the design's rows."""
    weight = design.rows / np.maximum(design.power.sum(axis=0), 1e-300)
    for _ in range(ROUNDS):
        theta = _solve(design, weight)
        left = [_left(design, j, theta) for j in range(design.dof)]
        weight = design.rows / np.maximum(left, 1e-12 * design.rms**2 * design.rows)
    return design.model.with_coefficients(design.model.coefficients() + theta)


def _solve(design: Design, weight: Array) -> Array:
    """Smallest change of the coefficients that leaves least. Shape (p,)."""
    size = len(design.nominal)
    gram, cross = np.zeros((size, size)), np.zeros(size)
    for j in range(design.dof):
        own, right, have = _sums(design, j)
        gram[np.ix_(have, have)] += weight[j] * own
        cross[have] += weight[j] * right
    return smallest_change(gram, cross)


def _sums(design: Design, j: int) -> tuple[Array, Array, Array]:
    """Gram and cross product of the nominal columns on joint j, and which they are."""
    place, have = design.present(j, design.nominal)
    gram, cross = design.total(j)
    return gram[np.ix_(place, place)], cross[place], have


def _left(design: Design, j: int, theta: Array) -> float:
    gram, cross, have = _sums(design, j)
    own = theta[have]
    return float(design.power[:, j].sum() - 2 * own @ cross + own @ gram @ own)


def set_back(model: Model, nominal: Model, effect) -> Model | None:
    """Set back what stands for an effect in a dense model.

    Args:
        effect: Anything with a name and joints from 1.

    Returns:
        The edited model; None where no parameter of it stands for the effect.
    """
    known, joints = registry()[effect.name], tuple(effect.joints)
    bodies = _body_slots(known, joints, model.robot.dof)
    if bodies:
        inertial = model.inertial.copy()
        for body in bodies:
            own = slice(10 * body, 10 * body + 10)
            inertial[own] = nominal.inertial[own]
        model = model.with_coefficients(
            np.concatenate([inertial, model.coefficients()[len(inertial) :]])
        )
    places = {(t.effect.name, j + 1) for t in model.terms for j in t.joints}
    had = [j for j in joints if (effect.name, j) in places]
    if not had and not bodies:
        return None
    return model.without(effect.name, had) if had else model


def _body_slots(known, joints: tuple[int, ...], dof: int) -> tuple[int, ...]:
    if known.carries == "body":
        return (dof - 1,)
    return tuple(j - 1 for j in joints) if known.scope == "link" else ()


FILTERED, MOVING = "filtered", "moving"


# The edit test: a named effect is taken out again, and nothing is refitted.
#
# A low error is no explanation. Dense least squares and a right cause predict unseen
# motion equally well; but taken out of its model only the right cause leaves the arm as
# it was without it ("Fidelity Is Not Identification", Kyung Hee University 2026).
#
# E = 100 ||tau - tau_hat(model without the effect)|| / ||tau||, over all joints, both
# sides through the identification filter, on logs of the arm that never had it.


class Placed(Protocol):
    """Whatever has a name and joints from 1: a finding, or what was hidden."""

    @property
    def name(self) -> str:
        """Its name."""

    @property
    def joints(self) -> tuple[int, ...]:
        """Its joints from 1; empty for the whole arm."""


def edited(model: Model, effects: Sequence[Placed]) -> Model:
    """Return a model without some effects; nothing is refitted.

    Raises:
        InputError: If it does not have one of them.
    """
    for effect in effects:
        model = model.without(effect.name, effect.joints or None)
    return model


def errors_on(
    models: Mapping[str, Model | None],
    logs: Sequence[Recording],
    kind: str = FILTERED,
) -> dict[str, Number]:
    """Return the error of each model on logs [%], None for one that there is not.

    Args:
        models: By name; logs are prepared with the signal path of the first.
        logs: Logs of the arm without what the models do not have.
        kind: Of which samples: "filtered", or "moving" for those that move alone, where
            friction is not any torque that holds.
    """
    some = {name: model for name, model in models.items() if model is not None}
    first = next(iter(some.values()))
    found, _ = compare(some, prepare_held_out(logs, first), first.filters)
    known = {n: plain(e.overall(kind)) for n, e in found.items() if e.alike}
    return {name: known.get(name) for name in models}


def baseline_edits(
    models: Mapping[str, Model],
    dense: Model,
    found: tuple[Sequence[Placed], Sequence[Placed]],
    baseline: Sequence[Recording],
) -> tuple[Edit, ...]:
    """Take what was found out of the augmented model, and predict the baseline.

    The baseline had none of it, so all of it goes; ``kept`` is with this one back.

    Args:
        models: "nominal" and "augmented" of a diagnosis with a baseline.
        dense: Dense least squares on the same logs.
        found: Effects that are named, and those that are folded into the background.
    """
    effects, every = found[0], [*found[0], *found[1]]
    nominal, augmented = models["nominal"], models["augmented"]
    bare, back = edited(augmented, every), dense
    for effect in every:
        back = set_back(back, nominal, effect) or back
    tried: dict[str, Model | None] = {"bare": bare, "nominal": nominal, "dense": back}
    for i, effect in enumerate(effects):
        others = [other for other in every if other is not effect]
        tried[f"kept {i}"] = edited(augmented, others)
    errors = errors_on(tried, baseline)
    return tuple(
        Edit(
            effect.name,
            tuple(effect.joints),
            errors["bare"],
            errors[f"kept {i}"],
            None if set_back(dense, nominal, effect) is None else errors["dense"],
            errors["nominal"],
        )
        for i, effect in enumerate(effects)
    )


def sealed_edit(
    effect: Placed,
    models: Mapping[str, Model],
    logs: Sequence[Recording],
    kind: str = FILTERED,
) -> Edit:
    """Judge one effect on the arm that has everything but it.

    Args:
        models: "augmented", "dense" and "nominal"; "oracle", the true arm without the
            effect, where it is known.

    Raises:
        InputError: If the augmented model does not have the effect.
    """
    augmented, dense, nominal = (models[k] for k in ("augmented", "dense", "nominal"))
    found = errors_on(
        {
            "edited": edited(augmented, [effect]),
            "kept": augmented,
            "dense": set_back(dense, nominal, effect),
            "oracle": models.get("oracle"),
        },
        logs,
        kind,
    )
    numbers = (found[k] for k in ("edited", "kept", "dense", "oracle"))
    return Edit(effect.name, tuple(effect.joints), *numbers)
