"""What a monitor sees of a log: motion, torque, and the cycles of a program.

All filters are windows of fixed length (Savitzky and Golay 1964). A value is stamped
with the time of the last sample that it is made of, never with the middle of its
window, so no alarm knows what comes after it.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import savgol_coeffs

from residual.errors import InputError
from residual.recording import Array, Recording
from residual.signals.pieces import LONG
from residual.signals.track import Track, sample_rate

HALF = 0.03  # s: half the window of the filters
STEP = 0.016  # s: between two rows
_ORDER = 3  # of the polynomial: fits what a servo does within 60 ms
_GAP = 1.5  # sample periods: more is a gap
_SHORTEST = 1.0  # s
_AT_ONCE = 1 << 14  # rows


@dataclass(frozen=True, eq=False, slots=True)
class Rows:
    """A log as rows of filtered motion and torque, each made of the samples before it.

    Attributes:
        id: Label of the recording.
        rate: Rows per second [Hz].
        t: Time of the last sample in each row [s]. Shape (m,).
        q, qd, qdd: Motion in the middle of the window [rad, ...]. Shape (m, dof).
        tau: Torque through the same window [N m]. Shape (m, dof).
        goal: Wanted position there [rad]. Shape (m, dof), or None.
        e_q, e_qd: Measured minus wanted [rad, rad/s]. Shape (m, dof), or None.
        whole: The window has no gap. Shape (m,), bool.
    """

    id: str
    rate: float
    t: Array
    q: Array
    qd: Array
    qdd: Array
    tau: Array
    goal: Array | None
    e_q: Array | None
    e_qd: Array | None
    whole: Array

    def track(self) -> Track:
        """The same as what a model looks at (``Model.observe``)."""
        moving = np.ones(self.q.shape, dtype=bool)
        return Track(
            id=self.id,
            rate=self.rate,
            t=self.t,
            q=self.q,
            qd=self.qd,
            qdd=self.qdd,
            cutoff=self.rate / 2,
            step=1,
            tau=self.tau,
            inner=self.whole,
            moving=moving,
            torque_noise=np.zeros(self.q.shape[1]),
        )


def rows_of(recording: Recording) -> Rows:
    """Filter a log.

    Raises:
        InputError: If it is shorter than a second, or so slow that a window of 60 ms
            has fewer than five samples.
    """
    rate = sample_rate(recording.t)
    half, step = round(HALF * rate), max(1, round(STEP * rate))
    if half < 2:
        raise InputError(
            f"{recording.id} is logged at {rate:g} Hz, expected at least 60 Hz to "
            "watch sensors. Log faster, or leave it out."
        )
    if recording.duration < _SHORTEST:
        raise InputError(
            f"{recording.id} lasts {recording.duration:g} s, expected at least "
            f"{_SHORTEST:g} s. Give a longer log."
        )
    late = np.diff(recording.t, prepend=recording.t[0]) > _GAP / rate
    ends = np.arange(2 * half, len(recording.t), step)
    gone = np.concatenate([[0], np.cumsum(late)])
    q, qd, qdd = (_filtered(recording.q, half, step, d, rate) for d in range(3))
    made = Rows(
        id=recording.id,
        rate=rate / step,
        t=recording.t[ends],
        q=q,
        qd=qd,
        qdd=qdd,
        tau=_filtered(recording.tau, half, step, 0, rate),
        goal=None,
        e_q=None,
        e_qd=None,
        # A gap before the first sample of a window does not spoil it.
        whole=gone[ends + 1] == gone[ends - 2 * half + 1],
    )
    if recording.q_ref is None:
        return made
    error = recording.q - recording.q_ref
    return replace(
        made,
        goal=recording.q_ref[ends - half],
        e_q=_filtered(error, half, step, 0, rate),
        e_qd=_filtered(error, half, step, 1, rate),
    )


def _filtered(x: Array, half: int, step: int, times: int, rate: float) -> Array:
    """The d-th derivative in the middle of windows of 2 half + 1 samples."""
    weights = savgol_coeffs(
        2 * half + 1, _ORDER, deriv=times, delta=1 / rate, use="dot"
    )
    windows = np.lib.stride_tricks.sliding_window_view(x, 2 * half + 1, axis=0)
    windows = windows[::step]
    # A product copies the windows, which are larger than the log: some at a time.
    starts = range(0, max(len(windows), 1), _AT_ONCE)
    return np.concatenate([windows[i : i + _AT_ONCE] @ weights for i in starts])


SAME = 2e-3  # rad: how near to its own past a wanted position is in the next cycle
_SHORTEST_CYCLE = 0.5  # s
_SHARE = 0.5  # of the rows that move must repeat; others are alike at any lag
_MOVING = 0.1  # of the rows must move


def period_of(rows: Rows) -> float | None:
    """Return the length of a cycle of the wanted motion [s], None if none repeats.

    A program is known before it runs, so this looks at the whole log; at the first ten
    minutes of a longer one.
    """
    if rows.goal is None:
        return None
    first = rows.goal[: round(LONG * rows.rate) + 1]
    goal, low = np.ascontiguousarray(first.T), round(_SHORTEST_CYCLE * rows.rate)
    step = np.abs(np.diff(goal, axis=1, prepend=goal[:, :1])).max(axis=0)
    for lag in range(low, goal.shape[1] - low):
        # Between two rows the best lag may lie: as near as the motion of a row.
        moves = step[lag:] > 0
        near = (_gap(goal, lag) < SAME + step[lag:])[moves]
        if moves.mean() > _MOVING and near.mean() > _SHARE:
            return _refined(goal, step, lag) / rows.rate
    return None


def before(values: Array, rows: Rows, period: float) -> Array:
    """Return values of a cycle ago; those of the first cycle are its first row."""
    t = rows.t - period
    return np.column_stack([np.interp(t, rows.t, column) for column in values.T])


def repeats(rows: Rows, period: float) -> Array:
    """Return where the wanted motion is that of a cycle ago. Shape (m,), bool.

    The first cycle is no example: each joint that stands in it was left there by other
    motion, and friction holds it at another torque than in all cycles after.
    """
    then = before(rows.goal, rows, period)
    known = rows.t - rows.t[0] >= 2 * period
    whole = np.interp(rows.t - period, rows.t, rows.whole.astype(float)) == 1.0
    same = np.abs(rows.goal - then).max(axis=1) < SAME
    return known & whole & same & rows.whole


def _gap(goal: Array, lag: int) -> Array:
    return np.abs(goal[:, lag:] - goal[:, :-lag]).max(axis=0)


def _refined(goal: Array, step: Array, lag: int) -> float:
    """Return the best lag near one, by a parabola through three misfits [rows]."""
    lags = np.arange(max(1, lag - 2), min(lag + 4, goal.shape[1] - 1))
    last = lags[-1]
    gaps = np.array([_gap(goal, k)[last - k :] for k in lags])
    alike = (gaps.min(axis=0) < SAME + step[last:]) & (step[last:] > 0)
    if not alike.any():
        return float(lag)
    misfit = np.mean(gaps[:, alike] ** 2, axis=1)
    best = int(np.clip(np.argmin(misfit), 1, len(misfit) - 2))
    left, middle, right = misfit[best - 1 : best + 2]
    bend = left - 2 * middle + right
    shift = 0.5 * (left - right) / bend if bend > 0 else 0.0
    return float(lags[best] + np.clip(shift, -1, 1))
