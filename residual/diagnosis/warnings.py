"""Sentences that qualify a verdict, also of torque that was filtered or delayed."""

from collections.abc import Sequence

import numpy as np

from residual.diagnosis.examine import Examined
from residual.diagnosis.gate import Tested
from residual.diagnosis.validation.standing import Withdrawn
from residual.evidence.rules import RULES
from residual.model.model import Model
from residual.model.nominal import Logs
from residual.names import joints_listed, listed
from residual.recording import Recording
from residual.signals.low_pass import low_pass, power_density
from residual.signals.pieces import in_pieces, let_go
from residual.signals.track import sample_rate

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
