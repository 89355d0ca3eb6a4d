"""What no arm can be: a refit whose friction drives, or whose inertia is negative.

Both are sums over the motion that are linear in the coefficients, so their standard
deviation follows from the fit's covariance: nothing is called impossible by chance.
"""

from collections.abc import Callable

import numpy as np

from residual.diagnosis.examine import Examined
from residual.evidence.fit import Fit
from residual.evidence.rules import RULES
from residual.model.compare import Errors
from residual.names import joints_listed
from residual.recording import Array
from residual.robot.dynamics import regressor

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
