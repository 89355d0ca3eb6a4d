"""The result of a diagnosis: verdict, models, curves; and the edit test."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from residual.effects import list_motor_alternatives, load_effects
from residual.effects.base import MotionSpan
from residual.evidence.design import Design
from residual.evidence.fit import PossibleModel, solve_minimum_norm
from residual.model.compare import ErrorSums, compute_model_errors, prepare_held_out
from residual.model.model import Model
from residual.model.records import PositionErrors
from residual.quantity import convert_to_plain_values
from residual.recording import Recording
from residual.robot.dynamics import find_flange_frame
from residual.robot.robot import Robot
from residual.verdict.result import (
    METRIC,
    Edit,
    ErrorTables,
    Finding,
    Frames,
    Number,
    Parameter,
    Place,
)


def add_motor_class(
    place: Place, equivalent: Sequence[Place], span: MotionSpan
) -> tuple[Place, ...]:
    """Add the equivalents that logs of one drive, without torque, cannot separate."""
    more = list_motor_alternatives(place.name, span)
    return tuple(dict.fromkeys([*equivalent, *(Place(n, place.joints) for n in more)]))


def name_frames(robot: Robot) -> Frames:
    """Return the URDF names of the joints and the flange of a robot."""
    flange = robot.model.frames[find_flange_frame(robot.model)].name
    return Frames(robot.joints, flange)


def replace_by_model_values(finding: Finding, possible: PossibleModel) -> Finding:
    """Replace the values of a finding by the model's, if its free fit is impossible.

    The deviations are kept: the true body is possible, and the nearest possible one is
    no farther from it than the fit.
    """
    effect, joints = load_effects()[finding.name], tuple(j - 1 for j in finding.joints)
    if possible.correction is None or effect.portable.bodies is None:
        return finding
    terms = possible.model.terms  # findings come after the terms of the model
    place = finding.name, joints
    (*_, term) = (t for t in terms if (t.effect.name, t.joints) == place)
    robot = possible.model.robot
    values = effect.values(term.theta, term.shape, robot)
    values = dict(zip(effect.parameters, values, strict=True))
    if effect.combined is not None:
        sums = effect.combined(term.theta, robot)
        values |= {key: value for key, (value, _) in sums.items()}

    def with_values(parameters: Mapping[str, Parameter]) -> dict[str, Parameter]:
        return {
            k: replace(p, value=convert_to_plain_values(values[k])) for k, p in parameters.items()
        }

    return replace(
        finding,
        parameters=with_values(finding.parameters),
        combinations=with_values(finding.combinations),
    )


def tabulate_errors(
    errors: Mapping[str, ErrorSums | None],
    cutoff: float,
    logs: Sequence[str],
    same_run: bool = False,
    worse: Sequence[int] = (),
    position: PositionErrors | None = None,
) -> ErrorTables:
    """Return the errors of several models as plain values [%].

    Args:
        errors: By name of the model; None for a model that is not there.
        cutoff: Of the identification filter [Hz].
        worse: Joints from 1 that the findings make worse beyond chance.
    """

    def overall(kind: str) -> dict:
        return {
            s: convert_to_plain_values(e.overall(kind)) if e and e.alike else None
            for s, e in errors.items()
        }

    def row(error: ErrorSums | None, kind: str) -> tuple[Number, ...] | None:
        values = np.array(np.nan) if error is None else error.per_joint(kind)
        return None if np.isnan(values).all() else tuple(convert_to_plain_values(values))

    def per_joint(kind: str) -> dict:
        return {s: row(e, kind) for s, e in errors.items()}

    return ErrorTables(
        metric=METRIC,
        cutoff_hz=cutoff,
        logs=tuple(logs),
        same_run=same_run,
        held_out=per_joint("raw"),
        filtered=per_joint("filtered"),
        moving=per_joint("moving"),
        overall=overall("raw"),
        overall_filtered=overall("filtered"),
        overall_moving=overall("moving"),
        worse=tuple(worse),
        position=position,
    )


ROUNDS = 3  # alternating iterations of parameters and noise


# Dense least squares: a fit without a search for a cause.
#
# All inertial parameters of all bodies and all declared coefficients are fitted freely,
# without a prior: by least squares weighted with the noise of each joint, on the same rows
# as the diagnosis (moving joints, both sides filtered). Of the equivalent solutions (there
# are fewer base parameters) the one nearest to the nominal parameters is chosen, in units
# of the torque of each: a body changes only if necessary.
#
# An effect is removed by resetting its parameters to those of the nominal model: for a
# load those of the last body, for a link those of the link, for declared friction or a
# rotor the coefficient. Nothing is refitted.


def fit_all_parameters(design: Design) -> Model:
    """Fit all coefficients of a design's nominal model freely, on the design's rows."""
    sums, size = [], len(design.nominal)
    for j in range(design.dof):  # of the nominal columns on each joint, and their indices
        place, have = design.present(j, design.nominal)
        gram, cross = design.total(j)
        sums.append((gram[np.ix_(place, place)], cross[place], have))
    weight = design.rows / np.maximum(design.power.sum(axis=0), 1e-300)
    for _ in range(ROUNDS):
        total, right = np.zeros((size, size)), np.zeros(size)
        for w, (gram, cross, have) in zip(weight, sums, strict=True):
            total[np.ix_(have, have)] += w * gram
            right[have] += w * cross
        theta = solve_minimum_norm(total, right)
        errors = [
            power.sum() - 2 * theta[have] @ cross + theta[have] @ gram @ theta[have]
            for power, (gram, cross, have) in zip(design.power.T, sums, strict=True)
        ]
        weight = design.rows / np.maximum(errors, 1e-12 * design.rms**2 * design.rows)
    return design.model.with_coefficients(design.model.coefficients() + theta)


def reset_effect_parameters(model: Model, nominal: Model, effect) -> Model | None:
    """Reset the parameters of an effect in a dense model.

    Args:
        effect: Anything with a name and joints from 1.

    Returns:
        The edited model; None if it has no parameters for the effect.
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


# The edit test: a named effect is removed without a refit.
#
# A low error is no explanation. Dense least squares and the right cause predict unseen
# motion equally well; but only removing the right cause restores the arm without it
# ("Fidelity Is Not Identification", Kyung Hee University 2026).
#
# E = 100 ||tau - tau_hat(model without the effect)|| / ||tau||, over all joints, both
# sides through the identification filter, on logs of the arm that never had it.


LocatedEffect = Place | Finding  # anything with a name and joints from 1, () for the arm


def remove_effects_from_model(model: Model, effects: Sequence[LocatedEffect]) -> Model:
    """Return a model without some effects; nothing is refitted.

    Raises:
        InputError: If it lacks one of them.
    """
    for effect in effects:
        model = model.without(effect.name, effect.joints or None)
    return model


def measure_errors(
    models: Mapping[str, Model | None], logs: Sequence[Recording]
) -> dict[str, Number]:
    """Return the error of each model on logs [%], None for a missing one.

    Args:
        models: By name; logs are prepared with the signal path of the first.
        logs: Logs of the arm without the removed effects.
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
    """Remove the findings from the augmented model, and predict the baseline.

    The baseline has none of them, so all are removed; ``kept`` restores one.

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
