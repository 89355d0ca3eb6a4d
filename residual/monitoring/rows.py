"""Rows of filtered motion and torque of a log, and its cycles.

All filters are windows of fixed length (Savitzky and Golay 1964). A row is stamped with
the time of the last sample that it is made of, never with the middle of its window, so
no alarm knows what comes after it.
"""

from dataclasses import dataclass, replace

import numpy as np

from residual.errors import InputError
from residual.monitoring.rules import MONITOR
from residual.recording import Array, Recording
from residual.signals.splitting import LONG
from residual.signals.track import Track, at_times, sample_rate

_AT_ONCE = 1 << 13  # windows: their copies are larger than the samples


@dataclass(frozen=True, slots=True)
class Window:
    """How rows are made of samples at one rate [Hz]."""

    rate: float

    @property
    def half(self) -> int:
        """Half the window [samples]."""
        return round(MONITOR.half * self.rate)

    @property
    def step(self) -> int:
        """Samples from row to row."""
        return max(1, round(MONITOR.step * self.rate))

    @property
    def row_rate(self) -> float:
        """Rows per second [Hz]."""
        return self.rate / self.step

    def filtered(self, x: Array, starts: Array, times: int = 0) -> Array:
        """Return a derivative in the middle of the windows that begin at some samples.

        Shape (m, dof).
        """
        from scipy.signal import savgol_coeffs

        width, out = 2 * self.half + 1, np.zeros((len(starts), x.shape[1]))
        weights = savgol_coeffs(
            width, MONITOR.order, deriv=times, delta=1 / self.rate, use="dot"
        )
        windows = np.lib.stride_tricks.sliding_window_view(x, width, axis=0)
        for i in range(0, len(starts), _AT_ONCE):
            part = slice(i, i + _AT_ONCE)
            out[part] = windows[starts[part]] @ weights
        return out


@dataclass(frozen=True, eq=False, slots=True)
class LogRows(Track):
    """A whole log as rows, with what was wanted; those without a gap are inner."""

    goal: Array | None = None  # wanted position there [rad]. Shape (m, dof), or None
    # Measured minus wanted [rad, rad/s]. Shape (m, dof), or None.
    e_q: Array | None = None
    e_qd: Array | None = None


def rows_of(recording: Recording) -> LogRows:
    """Filter a log.

    Raises:
        InputError: If it is shorter than a second, or so slow that a window of 60 ms
            has fewer than five samples.
    """
    window = Window(sample_rate(recording.t))
    if window.half < 2:
        raise InputError(
            f"{recording.id} is logged at {window.rate:g} Hz, expected at least 60 Hz "
            "to watch sensors. Log faster, or leave it out."
        )
    if recording.duration < MONITOR.shortest:
        raise InputError(
            f"{recording.id} lasts {recording.duration:g} s, expected at least "
            f"{MONITOR.shortest:g} s. Give a longer log."
        )
    t, q, half = recording.t, recording.q, window.half
    late = np.diff(t, prepend=t[0]) > MONITOR.gap / window.rate
    gone = np.concatenate([[0], np.cumsum(late)])
    starts = np.arange(0, len(t) - 2 * half, window.step)
    ends = starts + 2 * half
    rows = LogRows(
        recording.id,
        window.row_rate,
        t[ends],
        *(window.filtered(q, starts, times) for times in range(3)),
        cutoff=window.row_rate / 2,
        step=1,
        tau=window.filtered(recording.tau, starts),
        # A gap before the first sample of a window does not spoil it.
        inner=gone[ends + 1] == gone[starts + 1],
        moving=np.ones((len(ends), recording.dof), dtype=bool),
        torque_noise=np.zeros(recording.dof),
    )
    if recording.q_ref is None:
        return rows
    error = q - recording.q_ref
    e_q, e_qd = (window.filtered(error, starts, times) for times in range(2))
    return replace(rows, goal=recording.q_ref[starts + half], e_q=e_q, e_qd=e_qd)


def states_of(rows: LogRows) -> Array:
    """Return q, qd and qdd side by side. Shape (m, 3, dof)."""
    return np.stack([rows.q, rows.qd, rows.qdd], axis=1)


def beyond(rows: LogRows, lowest: Array, highest: Array, share: float) -> Array:
    """Where a state is outside of a range by more than a share of it. (m, dof), bool.

    The range is of q, qd and qdd. Shape (3, dof).
    """
    state, room = states_of(rows), share * (highest - lowest)
    return ((state < lowest - room) | (state > highest + room)).any(axis=1)


def period_of(rows: LogRows) -> float | None:
    """Return the length of a cycle of the wanted motion [s], None if none repeats.

    A program is known before it runs, so this looks at the whole log; at the first ten
    minutes of a longer one.
    """
    if rows.goal is None:
        return None
    first = rows.goal[: round(LONG * rows.rate) + 1]
    goal, low = np.ascontiguousarray(first.T), round(MONITOR.shortest_cycle * rows.rate)
    step = np.abs(np.diff(goal, axis=1, prepend=goal[:, :1])).max(axis=0)
    for lag in range(low, goal.shape[1] - low):
        # Between two rows the best lag may lie: as near as the motion of a row.
        moves = step[lag:] > 0
        near = (_gap(goal, lag) < MONITOR.same + step[lag:])[moves]
        if moves.mean() > MONITOR.moving and near.mean() > MONITOR.repeating:
            return _refined(goal, step, lag) / rows.rate
    return None


def before(values: Array, rows: LogRows, period: float) -> Array:
    """Return values of a cycle ago; those of the first cycle are its first row."""
    return at_times(rows.t - period, rows.t, values)


def repeats(rows: LogRows, period: float) -> Array:
    """Return where the wanted motion is that of a cycle ago. Shape (m,), bool.

    The first cycle is no example: each joint that stands in it was left there by other
    motion, and friction holds it at another torque than in all cycles after.
    """
    then = before(rows.goal, rows, period)
    known = rows.t - rows.t[0] >= 2 * period
    whole = np.interp(rows.t - period, rows.t, rows.inner.astype(float)) == 1.0
    same = np.abs(rows.goal - then).max(axis=1) < MONITOR.same
    return known & whole & same & rows.inner


def _gap(goal: Array, lag: int) -> Array:
    return np.abs(goal[:, lag:] - goal[:, :-lag]).max(axis=0)


def _refined(goal: Array, step: Array, lag: int) -> float:
    """Return the best lag near one, by a parabola through three misfits [rows]."""
    lags = np.arange(max(1, lag - 2), min(lag + 4, goal.shape[1] - 1))
    last = lags[-1]
    gaps = np.array([_gap(goal, k)[last - k :] for k in lags])
    alike = (gaps.min(axis=0) < MONITOR.same + step[last:]) & (step[last:] > 0)
    if not alike.any():
        return float(lag)
    misfit = np.mean(gaps[:, alike] ** 2, axis=1)
    best = int(np.clip(np.argmin(misfit), 1, len(misfit) - 2))
    left, middle, right = misfit[best - 1 : best + 2]
    bend = left - 2 * middle + right
    shift = 0.5 * (left - right) / bend if bend > 0 else 0.0
    return float(lags[best] + np.clip(shift, -1, 1))
