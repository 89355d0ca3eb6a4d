"""The yardstick that anyone has at hand: plain least squares, on the same logs.

All inertial parameters, the drive's rotor, Coulomb and viscous friction and a constant
torque of every joint, all free, every joint's error weighed alike. A diagnosis that
predicts worse than that is not worth its names, so it is held against it twice: on
parts of the fit logs that were left out, where the program itself finds out and gives
the model the constants that it lacks, and on the held-out logs, where the reader does.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from residual.diagnosis.gate import leave_out
from residual.diagnosis.search import Task
from residual.effects import registry
from residual.evidence.design import Design
from residual.evidence.fit import Fit, System, smallest_change
from residual.evidence.priors import SCALES, relative_prior
from residual.model.chance import SMALL, WORSE
from residual.model.model import Model
from residual.model.nominal import DEFAULT_DECLARED, Logs, start_nominal
from residual.model.standstill import with_standstill
from residual.names import joints_listed
from residual.recording import Array


@dataclass(frozen=True, eq=False, slots=True)
class Plain:
    """Plain least squares on the fit logs.

    Attributes:
        model: What it comes to.
        left: Squared error of each part of the logs, predicted from the others
            [N^2 m^2]. Shape (folds, dof).
    """

    model: Model
    left: Array


def plain_names(declared: tuple[str, ...]) -> tuple[str, ...]:
    """What a model has, then what every drive has, and a constant."""
    constant = tuple(e.name for e in registry().values() if e.is_constant)
    return tuple(dict.fromkeys((*declared, *DEFAULT_DECLARED, *constant)))


def plain_fit(logs: Logs) -> Plain:
    """Fit a robot's logs by plain least squares."""
    nominal = start_nominal(logs, plain_names(()))
    design = Design(logs.tracks, nominal.model)
    prior = relative_prior(design, nominal, SCALES[-1])
    whole = System.of(design, prior, ())
    gram, cross = whole.gram.sum(axis=0), whole.cross.sum(axis=0)
    left = []
    for own in whole.folds(design):
        rest = gram - own.gram.sum(axis=0), cross - own.cross.sum(axis=0)
        left.append(own.squared_error(smallest_change(*rest)))
    moved = nominal.model.coefficients() + smallest_change(gram, cross)
    model = nominal.model.with_coefficients(moved)
    return Plain(with_standstill(model, logs.sketch), np.array(left))


def outdone(task: Task, fitted: Fit, plain: Plain) -> dict[int, tuple[float, float]]:
    """Joints (from 0) on which plain least squares predicts left-out parts better.

    Args:
        plain: Plain least squares on the same logs.

    Returns:
        The error of both by joint, ours first, as shares of torque rms.
    """
    power = np.sqrt(np.maximum(task.design.tau_power.sum(axis=0), 1e-300))
    own = np.sqrt(leave_out(task, fitted).sum(axis=0)) / power
    theirs = np.sqrt(plain.left.sum(axis=0)) / power
    worse = (own > WORSE * theirs) & (own - theirs > SMALL)
    return {int(j): (own[j], theirs[j]) for j in np.flatnonzero(worse)}


def given_constants(
    task: Task, fitted: Fit, before: Mapping[int, tuple[float, float]]
) -> str:
    """What to say of constants that a model was given without a name.

    Args:
        before: Joints on which plain least squares was better without (`outdone`).
    """
    model, count = task.design.model, len(task.design.nominal)
    moved = model.with_coefficients(model.coefficients() + fitted.theta[:count])
    own = {
        t.joints[0]: t.theta[0]
        for t in moved.terms
        if t.effect.is_constant and t.joints[0] in before
    }
    worst = max(before, key=lambda j: before[j][0] - before[j][1])
    ours, theirs = (100 * x for x in before[worst])
    values = ", ".join(f"{own[j]:+.3g}" for j in before if j in own)
    return (
        f"{joints_listed(tuple(j + 1 for j in before))}: plain least squares, with a "
        "constant torque on every joint, predicted left-out parts of the logs better "
        f"(joint {worst + 1}: {ours:.1f} against {theirs:.1f} %), so the model was "
        f"given the constants that the logs show, without naming them: {values} N m"
    )
