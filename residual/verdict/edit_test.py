"""The edit test: a named effect is taken out of a fitted model again."""

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np

from residual.effects import load_effects
from residual.evidence.design import Design
from residual.evidence.fit import solve_minimum_norm
from residual.model.compare import compute_model_errors, prepare_held_out
from residual.model.model import Model
from residual.quantity import convert_to_plain_values
from residual.recording import Array, Recording
from residual.verdict.result import Edit, Number

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


def fit_all_parameters(design: Design) -> Model:
    """Fit all that a design's nominal model has, freely, on the design's rows."""
    weight = design.rows / np.maximum(design.power.sum(axis=0), 1e-300)
    for _ in range(ROUNDS):
        theta = _solve(design, weight)
        errors = [_squared_error(design, j, theta) for j in range(design.dof)]
        weight = design.rows / np.maximum(errors, 1e-12 * design.rms**2 * design.rows)
    return design.model.with_coefficients(design.model.coefficients() + theta)


def _solve(design: Design, weight: Array) -> Array:
    size = len(design.nominal)
    gram, cross = np.zeros((size, size)), np.zeros(size)
    for j in range(design.dof):
        own, right, have = _sums(design, j)
        gram[np.ix_(have, have)] += weight[j] * own
        cross[have] += weight[j] * right
    return solve_minimum_norm(gram, cross)


def _sums(design: Design, j: int) -> tuple[Array, Array, Array]:
    """Gram and cross product of the nominal columns on joint j, and their indices."""
    place, have = design.present(j, design.nominal)
    gram, cross = design.total(j)
    return gram[np.ix_(place, place)], cross[place], have


def _squared_error(design: Design, j: int, theta: Array) -> float:
    gram, cross, have = _sums(design, j)
    own = theta[have]
    return float(design.power[:, j].sum() - 2 * own @ cross + own @ gram @ own)


def reset_effect_parameters(model: Model, nominal: Model, effect) -> Model | None:
    """Set back what stands for an effect in a dense model.

    Args:
        effect: Anything with a name and joints from 1.

    Returns:
        The edited model; None where no parameter of it stands for the effect.
    """
    effect_type, joints = load_effects()[effect.name], tuple(effect.joints)
    bodies: tuple[int, ...] = ()
    if effect_type.carries == "body":
        bodies = (model.robot.dof - 1,)
    elif effect_type.scope == "link":
        bodies = tuple(j - 1 for j in joints)
    if bodies:
        inertial = model.inertial.copy()
        for body in bodies:
            own = slice(10 * body, 10 * body + 10)
            inertial[own] = nominal.inertial[own]
        model = model.with_coefficients(
            np.concatenate([inertial, model.coefficients()[len(inertial) :]])
        )
    places = {(t.effect.name, j + 1) for t in model.terms for j in t.joints}
    declared_joints = [j for j in joints if (effect.name, j) in places]
    if not declared_joints and not bodies:
        return None
    return model.without(effect.name, declared_joints) if declared_joints else model


# The edit test: a named effect is taken out again, and nothing is refitted.
#
# A low error is no explanation. Dense least squares and a right cause predict unseen
# motion equally well; but taken out of its model only the right cause leaves the arm as
# it was without it ("Fidelity Is Not Identification", Kyung Hee University 2026).
#
# E = 100 ||tau - tau_hat(model without the effect)|| / ||tau||, over all joints, both
# sides through the identification filter, on logs of the arm that never had it.


class LocatedEffect(Protocol):
    """Whatever has a name and joints from 1: a finding, or what was hidden."""

    @property
    def name(self) -> str:
        """Its name."""

    @property
    def joints(self) -> tuple[int, ...]:
        """Its joints from 1; empty for the whole arm."""


def remove_effects_from_model(model: Model, effects: Sequence[LocatedEffect]) -> Model:
    """Return a model without some effects; nothing is refitted.

    Raises:
        InputError: If it does not have one of them.
    """
    for effect in effects:
        model = model.without(effect.name, effect.joints or None)
    return model


def measure_errors(
    models: Mapping[str, Model | None], logs: Sequence[Recording]
) -> dict[str, Number]:
    """Return the error of each model on logs [%], None for one that there is not.

    Args:
        models: By name; logs are prepared with the signal path of the first.
        logs: Logs of the arm without what the models do not have.
    """
    some = {name: model for name, model in models.items() if model is not None}
    first = next(iter(some.values()))
    found, _ = compute_model_errors(some, prepare_held_out(logs, first), first.filters)
    known = {n: convert_to_plain_values(e.overall("filtered")) for n, e in found.items() if e.alike}
    return {name: known.get(name) for name in models}


def run_edit_tests(
    models: Mapping[str, Model],
    dense: Model,
    effects: Sequence[LocatedEffect],
    background: Sequence[LocatedEffect],
    baseline: Sequence[Recording],
) -> tuple[Edit, ...]:
    """Take what was found out of the augmented model, and predict the baseline.

    The baseline had none of it, so all of it goes; ``kept`` is with this one back.

    Args:
        models: "nominal" and "augmented" of a diagnosis with a baseline.
        dense: Dense least squares on the same logs.
        effects: The named effects.
        background: Effects that any used arm has.
    """
    every = [*effects, *background]
    nominal, augmented = models["nominal"], models["augmented"]
    bare, back = remove_effects_from_model(augmented, every), dense
    for effect in every:
        back = reset_effect_parameters(back, nominal, effect) or back
    tried: dict[str, Model | None] = {"bare": bare, "nominal": nominal, "dense": back}
    for i, effect in enumerate(effects):
        others = [other for other in every if other is not effect]
        tried[f"kept {i}"] = remove_effects_from_model(augmented, others)
    errors = measure_errors(tried, baseline)
    return tuple(
        Edit(
            effect.name,
            tuple(effect.joints),
            errors["bare"],
            errors[f"kept {i}"],
            None if reset_effect_parameters(dense, nominal, effect) is None else errors["dense"],
            errors["nominal"],
        )
        for i, effect in enumerate(effects)
    )
