"""Was the torque filtered or delayed before it was logged?"""

from collections.abc import Sequence

import numpy as np
from scipy.signal import welch

from residual.model.fit_logs import Logs
from residual.model.model import Model
from residual.recording import Recording
from residual.signals.track import low_pass, sample_rate

QUIET = (
    0.02  # high-band density, as a share of the middle band, that white noise never has
)
LEAST_DELAY = 0.004  # s
SHIFTS = 0.002 * np.arange(-15, 16)  # s


def filtered_at_source(recordings: Sequence[Recording]) -> str | None:
    """Say so if the torque channel carries no noise near its Nyquist frequency.

    White measurement noise has a flat spectrum. Where the density in the top fifth of
    the band is under 2 % of that between 20 % and 40 % of it on most joints, a
    low-pass at the source has taken it away.
    """
    shares, rates = [], []
    for recording in recordings:
        rate = sample_rate(recording.t)
        length = min(512, len(recording.t))
        f, density = welch(recording.tau, rate, nperseg=length, axis=0)
        top, middle = f > 0.4 * rate, (f > 0.1 * rate) & (f < 0.2 * rate)
        shares.append(
            density[top].mean(axis=0) / (density[middle].mean(axis=0) + 1e-30)
        )
        rates.append(rate)
    share = np.median(np.array(shares), axis=0)
    dead = np.all([np.ptp(r.tau, axis=0) == 0 for r in recordings], axis=0)
    share[dead] = 1.0
    quiet = [j + 1 for j in np.flatnonzero(share < QUIET)]
    if len(quiet) <= len(share) / 2:
        return None
    return (
        f"torque looks low-pass filtered at the source on joints {_list(quiet)}: its "
        f"noise density near {0.45 * min(rates):.0f} Hz is under {100 * QUIET:.0f} % "
        "of that in mid band, so noise and detectable sizes are understated"
    )


def delayed_at_source(model: Model, logs: Logs) -> str | None:
    """Say so if the torque fits the model better when shifted in time.

    The shift is the one that correlates measured and predicted torque best on the fit
    logs, by joint; half of the joints or more must agree within a third.
    """
    miss = np.zeros((len(SHIFTS), model.robot.dof))
    for track in logs.tracks:
        torque = low_pass(
            model.torque_of_state(model.observe(track)), track.cutoff, track.rate
        )
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
    if abs(delay) < LEAST_DELAY or agree < 0.5:
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


def _list(numbers: Sequence[int]) -> str:
    return ", ".join(str(n) for n in numbers)
