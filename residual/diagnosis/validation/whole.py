"""The yardstick that anyone has at hand: plain least squares, on the same logs.

All inertial parameters, the drive's rotor, Coulomb and viscous friction and a constant
torque of every joint, all free, every joint's error weighed alike. A diagnosis that
predicts worse than that is not worth its names, so it is held against it twice: on
parts of the fit logs that were left out, where the program itself finds out and gives
the model the constants that it lacks, and on the held-out logs, where the reader does.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from residual.diagnosis.examine import Examined
from residual.diagnosis.gate import leave_out
from residual.diagnosis.search import Task
from residual.effects import registry
from residual.evidence.design import Design
from residual.evidence.fit import Fit, System, smallest_change
from residual.evidence.priors import SCALES, relative_prior
from residual.evidence.rules import RULES
from residual.model.chance import SMALL, WORSE
from residual.model.compare import Errors
from residual.model.model import Model
from residual.model.nominal import (
    DEFAULT_DECLARED,
    Logs,
    start_nominal,
    with_standstill,
)
from residual.names import joints_listed
from residual.recording import Array
from residual.robot.dynamics import regressor


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


PLACES = 20  # positions at which the inertia is looked at


def contradictions(
    examined: Examined, fitted: Fit, errors: dict[str, Errors]
) -> tuple[str, ...]:
    """Return in sentences what of a fit no arm can be; empty where nothing is."""
    friction, inertia = _driving(examined, fitted), _negative(examined, fitted)
    out = []
    if friction:
        one = len(friction) == 1
        out.append(
            f"the friction that was fitted on {joints_listed(friction)} drives the arm "
            f"instead of braking it, which no friction does: is the sign of "
            f"{'this torque' if one else 'these torques'} right?"
        )
    if inertia:
        out.append(
            f"the inertia that was fitted on {joints_listed(inertia)} is negative, "
            "which no body has: are signs, units and the order of the joints right?"
        )
    before, after = (errors[k].overall("moving") for k in ("nominal", "identified"))
    if after > RULES.far_worse * before:
        out.append(
            "the refit predicts held-out motion worse than the model as it was given "
            f"({before:.1f} to {after:.1f} % while moving): these logs do not "
            "determine it"
        )
    return tuple(out)


def _driving(examined: Examined, fitted: Fit) -> list[int]:
    """Joints (from 1) on which the fitted friction feeds the motion."""
    design, covariance = examined.task.design, fitted.covariance()
    theta, out = _whole(examined, fitted), []
    brakes = _marked(examined, fitted, lambda effect, joints: effect.brakes)
    speeds = design.stacked([t.qd[:: t.step] for t in examined.logs.sketch])
    for j, speed in enumerate(speeds):
        place, have = design.present(j, fitted.ids)
        mine = brakes[have]
        along = np.zeros(len(theta))
        along[have[mine]] = design.columns(j, place[mine]).T @ speed
        power, sd = along @ theta, np.sqrt(max(along @ covariance @ along, 0.0))
        moved = np.abs(speed) @ np.abs(design.tau[j])
        if power < -RULES.beyond * sd and power < -RULES.least_power * moved:
            out.append(j + 1)
    return out


def _negative(examined: Examined, fitted: Fit) -> list[int]:
    """Joints (from 1) whose own inertia came out negative over the logged places."""
    design, covariance = examined.task.design, fitted.covariance()
    theta, model = _whole(examined, fitted), examined.logs.robot.model
    q = np.concatenate([t.q for t in examined.logs.tracks])
    q = q[:: max(1, len(q) // PLACES)]
    still, out = np.zeros_like(q), []
    resting = regressor(model, q, still, still)
    for j in range(design.dof):
        push = still.copy()
        push[:, j] = 1.0
        rows = regressor(model, q, still, push)[:, j] - resting[:, j]
        rotors = _marked(
            examined,
            fitted,
            lambda e, on, j=j: e.carries == "acceleration" and on == (j,),
        )
        along = rotors.astype(float)
        along[: rows.shape[1]] = rows.mean(axis=0)
        own, sd = along @ theta, np.sqrt(max(along @ covariance @ along, 0.0))
        if own < -RULES.beyond * sd and own < 0:
            out.append(j + 1)
    return out


def _whole(examined: Examined, fitted: Fit) -> Array:
    """Coefficients themselves, where a fit has their distance from the nominal."""
    theta = fitted.theta.copy()
    base = examined.nominal.model.coefficients()
    theta[: len(base)] += base
    return theta


def _marked(examined: Examined, fitted: Fit, wanted: Callable) -> Array:
    """Which of a fit's coefficients belong to effects that are wanted. (m,), bool."""
    model = examined.nominal.model
    marks = [np.zeros(len(model.inertial), dtype=bool)]
    for part in (*model.terms, *fitted.members):
        count = len(part.theta) if hasattr(part, "theta") else len(part.ids)
        marks.append(np.full(count, bool(wanted(part.effect, part.joints))))
    return np.concatenate(marks)
