"""Rows of filtered motion and torque, of whole logs and of streams, and their cycles.

All filters are windows of fixed length (Savitzky and Golay 1964). A row is stamped with
the time of the last sample that it is made of, never with the middle of its window, so
no alarm knows what comes after it. Rows of a stream are made of the samples of their
window and its place in an unbroken piece of them, never of the batch that they came in:
cut otherwise, the same samples make the same rows.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np
from scipy.signal import savgol_coeffs

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
        width, out = 2 * self.half + 1, np.zeros((len(starts), x.shape[1]))
        if not len(starts):
            return out
        weights = savgol_coeffs(
            width, MONITOR.order, deriv=times, delta=1 / self.rate, use="dot"
        )
        windows = np.lib.stride_tricks.sliding_window_view(x, width, axis=0)
        for i in range(0, len(starts), _AT_ONCE):
            part = slice(i, i + _AT_ONCE)
            out[part] = windows[starts[part]] @ weights
        return out


class _Arrays:
    """Arrays side by side, as long as each other."""

    __slots__ = ()

    def __getitem__(self, rows: slice | Array) -> Self:
        return type(self)(*(getattr(self, f.name)[rows] for f in fields(self)))

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Return them one after the other."""
        names = (f.name for f in fields(cls))
        return cls(*(np.concatenate([getattr(p, n) for p in parts]) for n in names))


@dataclass(frozen=True, eq=False, slots=True)
class Samples(_Arrays):
    """What an arm has logged since the last batch."""

    t: Array  # times [s], (n,)
    q: Array  # positions [rad], (n, dof)
    tau: Array  # torques [N m], (n, dof)


@dataclass(frozen=True, slots=True)
class Heard:
    """What there was to say of the samples, counted from the begin of the stream."""

    samples: int = 0  # that were used
    broken: int = 0  # without a number in every column, and left out
    late: int = 0  # at a time that had been already, and left out
    gaps: int = 0  # longer than one and a half periods
    restarts: int = 0  # of the clock, by more than a second back


@dataclass(frozen=True, eq=False, slots=True)
class Pending:
    """What has to be known of the samples before."""

    kept: Samples  # the last samples of the piece, a window less one at most
    count: int = 0  # samples in the piece so far
    heard: Heard = Heard()  # what there was to say


@dataclass(frozen=True, eq=False, slots=True)
class Rows(_Arrays):
    """Filtered motion and torque, stamped with the last sample of each window."""

    t: Array  # times [s], (m,)
    # Motion in the middle of the window [rad, ...], (m, dof).
    q: Array
    qd: Array
    qdd: Array
    tau: Array  # torque through the same window [N m], (m, dof)
    begins: Array  # it is the first of a piece. Shape (m,), bool

    @classmethod
    def none(cls, dof: int) -> Self:
        """Return no row."""
        empty = (np.empty((0, dof)) for _ in range(4))
        return cls(np.empty(0), *empty, np.empty(0, bool))


def start(dof: int) -> Pending:
    """Return what is known before the first sample."""
    return Pending(Samples(np.empty(0), np.empty((0, dof)), np.empty((0, dof))))


def take(tail: Pending, new: Samples, window: Window) -> tuple[Pending, Rows]:
    """Make the rows that a batch completes.

    Samples without a number, or at a time that was already, are left out. Over a gap,
    and where the clock was set back, nothing is filtered: a new piece begins.

    Returns:
        What is to be known for the next batch, and the rows, none at all maybe.
    """
    used, heard = _in_order(new, tail)
    parts: list[Rows] = []
    for piece, fresh in _pieces(used, tail, window.rate):
        if fresh:
            if len(tail.kept.t):
                what = "restarts" if piece.t[0] <= tail.kept.t[-1] else "gaps"
                heard = replace(heard, **{what: getattr(heard, what) + 1})
            tail = start(new.q.shape[1])
        tail, rows = _of_piece(tail, piece, window)
        parts.append(rows)
    return replace(tail, heard=heard), Rows.joined([Rows.none(new.q.shape[1]), *parts])


def _in_order(new: Samples, tail: Pending) -> tuple[Samples, Heard]:
    """Leave out what cannot be used, and count it."""
    signals = np.column_stack([new.t, new.q, new.tau])
    finite = np.isfinite(signals).all(axis=1)
    good = new[finite]
    keep = _rising(good.t, tail.kept.t[-1] if len(tail.kept.t) else -np.inf)
    now = {"samples": keep.sum(), "broken": (~finite).sum(), "late": (~keep).sum()}
    heard = {k: getattr(tail.heard, k) + int(n) for k, n in now.items()}
    return good[keep], replace(tail.heard, **heard)


def _rising(t: Array, last: float) -> Array:
    """Where time goes on, or was set back by more than a second. Shape (n,), bool."""
    keep = np.ones(len(t), bool)
    if (np.diff(t, prepend=last) > 0).all():
        return keep
    for i, now in enumerate(t):
        keep[i] = now > last or now < last - MONITOR.restart
        last = now if keep[i] else last
    return keep


def _pieces(
    used: Samples, tail: Pending, rate: float
) -> Iterator[tuple[Samples, bool]]:
    """Cut samples where there is a gap; say of each part whether one is before it."""
    if not len(used.t):
        return
    last = tail.kept.t[-1] if len(tail.kept.t) else used.t[0]
    step = np.diff(used.t, prepend=last)
    breaks = np.flatnonzero((step > MONITOR.gap / rate) | (step < 0))
    edges = [0, *(int(i) for i in breaks if i > 0), len(used.t)]
    fresh = {int(i) for i in breaks}
    for first, stop in itertools.pairwise(edges):
        yield used[first:stop], first in fresh


def _of_piece(tail: Pending, piece: Samples, window: Window) -> tuple[Pending, Rows]:
    width, had = 2 * window.half + 1, len(tail.kept.t)
    whole = Samples.joined([tail.kept, piece])
    offset = tail.count - had  # place in the piece of the first sample at hand
    total = tail.count + len(piece.t)
    first = max(width - 1, tail.count)
    first += (width - 1 - first) % window.step
    ends = np.arange(first, total, window.step)
    starts = ends - offset - (width - 1)
    kept = whole[np.arange(max(0, len(whole.t) - (width - 1)), len(whole.t))]
    moved = [window.filtered(whole.q, starts, times) for times in range(3)]
    torque, begins = window.filtered(whole.tau, starts), ends == width - 1
    rows = Rows(whole.t[starts + width - 1], *moved, torque, begins)
    return Pending(kept, total, tail.heard), rows


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


def states_of(rows: Rows | LogRows) -> Array:
    """Return q, qd and qdd side by side. Shape (m, 3, dof)."""
    return np.stack([rows.q, rows.qd, rows.qdd], axis=1)


def beyond(rows: Rows | LogRows, lowest: Array, highest: Array, share: float) -> Array:
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
