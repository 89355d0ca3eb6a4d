"""The yardstick that anyone has at hand: plain least squares, on the same logs.

All inertial parameters, the drive's rotor, Coulomb and viscous friction and a constant
torque of every joint, all free, every joint's error weighed alike. A diagnosis that
predicts worse than that is not worth its names, so it is held against it on the
held-out logs.
"""

from collections.abc import Callable, Sequence

import numpy as np

from residual.diagnosis.examine import Examined
from residual.diagnosis.gate import Tested
from residual.diagnosis.standing import Withdrawn
from residual.effects import registry
from residual.effects.base import Trait
from residual.errors import joints_listed, listed
from residual.evidence.design import Design
from residual.evidence.fit import Fit, System, smallest_change
from residual.evidence.priors import SCALES, relative_prior
from residual.evidence.rules import RULES
from residual.model.compare import Errors
from residual.model.model import Model
from residual.model.nominal import (
    DEFAULT_DECLARED,
    Logs,
    start_nominal,
    with_standstill,
)
from residual.recording import Array, Recording
from residual.robot.dynamics import regressor
from residual.signals.filters import low_pass, power_density
from residual.signals.splitting import in_pieces, let_go
from residual.signals.track import sample_rate


def plain_fit(logs: Logs) -> Model:
    """Fit a robot's logs by plain least squares."""
    constant = (e.name for e in registry().values() if Trait.CONSTANT in e.traits)
    nominal = start_nominal(logs, (*DEFAULT_DECLARED, *constant))
    design = Design(logs.tracks, nominal.model)
    whole = System.of(design, relative_prior(design, nominal, SCALES[-1]), ())
    least = smallest_change(whole.gram.sum(axis=0), whole.cross.sum(axis=0))
    model = nominal.model.with_coefficients(nominal.model.coefficients() + least)
    return with_standstill(model, logs.sketch)


PLACES = 20  # positions at which the inertia is looked at
STILL = "these logs show no motion, so nothing can be said of the arm"


# What no arm can be: a refit whose friction drives, or whose inertia is negative.
#
# Both are sums over the motion that are linear in the coefficients, so their standard
# deviation follows from the fit's covariance: nothing is called impossible by chance.


def contradictions(
    examined: Examined, fitted: Fit, errors: dict[str, Errors]
) -> tuple[str, ...]:
    """Return in sentences what of a fit no arm can be; empty where nothing is."""
    if not examined.task.design.fold_rows.any():
        return (STILL,)
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
    brakes = _marked(examined, fitted, lambda e, on: Trait.FRICTION in e.traits)
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


QUIET = (
    0.02  # high-band density, as a share of the middle band, that white noise never has
)
SHIFTS = 0.002 * np.arange(-15, 16)  # s


def filtered_at_source(recordings: Sequence[Recording]) -> str | None:
    """Say so if the torque channel carries no noise near its Nyquist frequency.

    White measurement noise has a flat spectrum. Where the density in the top fifth of
    the band is under 2 % of that between 20 % and 40 % of it on most joints, a
    low-pass at the source has taken it away.
    """
    shares, rates = [], []
    for recording in in_pieces(recordings):
        rate = sample_rate(recording.t)
        length = min(512, len(recording.t))
        f, density = power_density(recording.tau, length)
        top, middle = f > 0.4, (f > 0.1) & (f < 0.2)
        shares.append(
            density[top].mean(axis=0) / (density[middle].mean(axis=0) + 1e-30)
        )
        rates.append(rate)
        let_go(recording)
    share = np.median(np.array(shares), axis=0)
    dead = np.all([np.ptp(r.tau, axis=0) == 0 for r in recordings], axis=0)
    share[dead] = 1.0
    quiet = [j + 1 for j in np.flatnonzero(share < QUIET)]
    if len(quiet) <= len(share) / 2:
        return None
    return (
        f"torque looks low-pass filtered at the source on joints {listed(quiet)}: its "
        f"noise density near {0.45 * min(rates):.0f} Hz is under {100 * QUIET:.0f} % "
        "of that in mid band, so noise and detectable sizes are understated"
    )


def delayed_at_source(model: Model, logs: Logs) -> str | None:
    """Say so if the torque fits the model better when shifted in time.

    The shift is the one that correlates measured and predicted torque best on the fit
    logs, by joint; half of the joints or more must agree within a third.
    """
    miss = np.zeros((len(SHIFTS), model.robot.dof))
    for track in logs.sketch:
        torque = low_pass(model.torque_on(track), track.cutoff, track.rate)
        rows = track.t[:: track.step]
        for i, shift in enumerate(SHIFTS):
            moved = [np.interp(rows - shift, track.t, column) for column in torque.T]
            gap = (track.tau - np.column_stack(moved)) * track.moving
            miss[i] += (gap**2).sum(axis=0)
    # A joint that stands has no say: its sums are zero at every shift.
    shifts = [_vertex(SHIFTS, column) for column in miss.T if column.max() > 0]
    if not shifts:
        return None
    delay = float(np.median(shifts))
    agree = np.mean(np.abs(np.array(shifts) - delay) < max(abs(delay) / 3, 1e-3))
    if abs(delay) < RULES.least_delay or agree < 0.5:
        return None
    return (
        f"torque seems {'late' if delay > 0 else 'early'} against position by "
        f"{1000 * abs(delay):.0f} ms; findings that follow speed or acceleration "
        "may be part of it"
    )


def _vertex(x: np.ndarray, y: np.ndarray) -> float:
    """Minimum of samples, refined by a parabola."""
    i = int(np.clip(np.argmin(y), 1, len(y) - 2))
    curve = y[i - 1] - 2 * y[i] + y[i + 1]
    shift = 0.5 * (y[i - 1] - y[i + 1]) / curve if curve > 0 else 0.0
    return float(x[i] + np.clip(shift, -1, 1) * (x[1] - x[0]))


def warnings(
    examined: Examined, withdrawn: Sequence[Withdrawn], same_run: bool
) -> list[str]:
    """Return what qualifies the answer: a weak proof, a rough model, names withdrawn.

    Args:
        withdrawn: Names that did not stand.
        same_run: Whether the held-out logs are a part of a fit log.
    """
    out = []
    if same_run:
        out.append(
            "no --holdout given: the last quarter of the longest log was held out; "
            "the proof is weak, since it is the same run"
        )
    scale = examined.task.prior.scale
    if scale > RULES.rough:
        off = "100 % or more" if scale >= 1 else f"about {100 * scale:.0f} %"
        out.append(
            f"the inertias of the nominal model are off by {off}: too rough to blame a "
            "single body of the arm; give --baseline"
        )
    out += [complaint(w.tested, w.why) for w in withdrawn]
    return list(dict.fromkeys(out))  # two ripples of a joint make one sentence


def complaint(tested: Tested, why: str) -> str:
    """A warning about a name that did not stand: 'ripple on joint 3: why'."""
    joints = [j + 1 for j in tested.group.joints]
    place = f" on {joints_listed(joints)}" if joints else ""
    return f"{tested.group.effect.name}{place}: {why}"


def signal_notes(
    examined: Examined, fit: Sequence[Recording], augmented: Model
) -> tuple[str, ...]:
    """Return what was understood of the signals: filter, rows, faults of logging."""
    logs = examined.logs
    rows = examined.task.design.rows
    every = sum(int(t.inner.sum()) for t in logs.tracks)
    notes = [
        f"identification filter {min(t.cutoff for t in logs.tracks):g} Hz, zero phase, "
        "on torque and regressor alike; "
        f"{logs.filters.edge:g} s dropped at both ends",
        "moving rows used per joint: "
        + ", ".join(f"{100 * r / max(every, 1):.0f} %" for r in rows),
    ]
    if logs.clock is None:
        notes.append("the order of the logs in time is not known: warm-up not tested")
    more = (filtered_at_source(fit), delayed_at_source(augmented, logs))
    return (*notes, *(s for s in more if s))
