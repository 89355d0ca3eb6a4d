"""Samples as they come, to rows of filtered motion and torque, batch by batch.

The filters are those of `residual.monitoring.track`. A row is made of the samples of
its window and its place in an unbroken piece of them, never of the batch that they came
in: cut otherwise, the same samples make the same rows.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.signal import savgol_coeffs

from residual.monitoring.track import HALF, STEP
from residual.recording import Array

_ORDER = 3  # of the polynomial, as in `track`
_GAP = 1.5  # sample periods: more is a gap
RESTART = 1.0  # s: a clock that falls back by more was set anew


@dataclass(frozen=True, eq=False, slots=True)
class Samples:
    """What an arm has logged since the last batch.

    Attributes:
        t: Times [s]. Shape (n,).
        q: Positions [rad]. Shape (n, dof).
        tau: Torques [N m]. Shape (n, dof).
    """

    t: Array
    q: Array
    tau: Array

    def __getitem__(self, rows) -> "Samples":
        return Samples(self.t[rows], self.q[rows], self.tau[rows])


@dataclass(frozen=True, slots=True)
class Heard:
    """What there was to say of the samples, counted from the begin of the stream.

    Attributes:
        samples: That were used.
        broken: Without a number in every column, and left out.
        late: At a time that had been already, and left out.
        gaps: Longer than one and a half periods.
        restarts: Of the clock, by more than a second back.
    """

    samples: int = 0
    broken: int = 0
    late: int = 0
    gaps: int = 0
    restarts: int = 0


@dataclass(frozen=True, eq=False, slots=True)
class Tail:
    """What has to be known of the samples before.

    Attributes:
        kept: The last samples of the piece, a window less one at most.
        count: Samples in the piece so far.
        heard: What there was to say.
    """

    kept: Samples
    count: int = 0
    heard: Heard = Heard()


@dataclass(frozen=True, eq=False, slots=True)
class Rows:
    """Filtered motion and torque, stamped with the last sample of each window.

    Attributes:
        t: Times [s]. Shape (m,).
        q, qd, qdd: Motion in the middle of the window [rad, ...]. Shape (m, dof).
        tau: Torque through the same window [N m]. Shape (m, dof).
        begins: It is the first of a piece. Shape (m,), bool.
    """

    t: Array
    q: Array
    qd: Array
    qdd: Array
    tau: Array
    begins: Array

    def __getitem__(self, rows: slice | Array) -> "Rows":
        return Rows(*(getattr(self, f.name)[rows] for f in fields(self)))

    @classmethod
    def joined(cls, parts: Sequence["Rows"]) -> "Rows":
        """Return rows one after the other."""
        names = (f.name for f in fields(cls))
        return cls(*(np.concatenate([getattr(p, n) for p in parts]) for n in names))


@dataclass(frozen=True, slots=True)
class Window:
    """How rows are made at one rate.

    Attributes:
        rate: Rate of the samples [Hz].
    """

    rate: float

    @property
    def half(self) -> int:
        """Half the window [samples]."""
        return round(HALF * self.rate)

    @property
    def step(self) -> int:
        """Samples from row to row."""
        return max(1, round(STEP * self.rate))

    @property
    def row_rate(self) -> float:
        """Rows per second [Hz]."""
        return self.rate / self.step


def start(dof: int) -> Tail:
    """Return what is known before the first sample."""
    return Tail(Samples(np.empty(0), np.empty((0, dof)), np.empty((0, dof))))


def take(tail: Tail, new: Samples, window: Window) -> tuple[Tail, Rows]:
    """Make the rows that a batch completes.

    Samples without a number, or at a time that was already, are left out. Over a gap,
    and where the clock was set back, nothing is filtered: a new piece begins.

    Args:
        new: The batch; may be empty, or hold NaN.

    Returns:
        What is to be known for the next batch, and the rows, none at all maybe.
    """
    used, heard = _in_order(new, tail)
    parts: list[Rows] = []
    for piece, fresh in _pieces(used, tail, window.rate):
        if fresh:
            restart = bool(len(tail.kept.t)) and piece.t[0] <= tail.kept.t[-1]
            heard = _counted(heard, tail, restart)
            tail = start(new.q.shape[1])
        tail, rows = _of_piece(tail, piece, window)
        parts.append(rows)
    made = Rows.joined(parts) if parts else _none(new.q.shape[1])
    return replace(tail, heard=heard), made


def _in_order(new: Samples, tail: Tail) -> tuple[Samples, Heard]:
    """Leave out what cannot be used, and count it."""
    heard = tail.heard
    signals = np.column_stack([new.t, new.q, new.tau])
    finite = np.isfinite(signals).all(axis=1)
    good = new[finite]
    last = tail.kept.t[-1] if len(tail.kept.t) else -np.inf
    keep = _rising(good.t, last)
    return good[keep], replace(
        heard,
        samples=heard.samples + int(keep.sum()),
        broken=heard.broken + int((~finite).sum()),
        late=heard.late + int((~keep).sum()),
    )


def _rising(t: Array, last: float) -> Array:
    """Where time goes on, or was set back by more than a second. Shape (n,), bool."""
    keep = np.ones(len(t), bool)
    if (np.diff(t, prepend=last) > 0).all():
        return keep
    for i, now in enumerate(t):
        keep[i] = now > last or now < last - RESTART
        last = now if keep[i] else last
    return keep


def _pieces(used: Samples, tail: Tail, rate: float) -> Iterator[tuple[Samples, bool]]:
    """Cut samples where there is a gap; say of each part whether one is before it."""
    if not len(used.t):
        return
    last = tail.kept.t[-1] if len(tail.kept.t) else used.t[0]
    step = np.diff(used.t, prepend=last)
    breaks = np.flatnonzero((step > _GAP / rate) | (step < 0))
    edges = [0, *(int(i) for i in breaks if i > 0), len(used.t)]
    fresh = {int(i) for i in breaks}
    for first, stop in itertools.pairwise(edges):
        yield used[first:stop], first in fresh


def _counted(heard: Heard, tail: Tail, restart: bool) -> Heard:
    if not len(tail.kept.t):
        return heard
    if restart:
        return replace(heard, restarts=heard.restarts + 1)
    return replace(heard, gaps=heard.gaps + 1)


def _of_piece(tail: Tail, piece: Samples, window: Window) -> tuple[Tail, Rows]:
    width = 2 * window.half + 1
    had = len(tail.kept.t)
    t = np.concatenate([tail.kept.t, piece.t])
    q = np.concatenate([tail.kept.q, piece.q])
    tau = np.concatenate([tail.kept.tau, piece.tau])
    offset = tail.count - had  # place in the piece of the first sample at hand
    total = tail.count + len(piece.t)
    first = max(width - 1, tail.count)
    first += (width - 1 - first) % window.step
    ends = np.arange(first, total, window.step)
    starts = ends - offset - (width - 1)
    cut = slice(max(0, len(t) - (width - 1)), None)
    kept = Samples(t[cut].copy(), q[cut].copy(), tau[cut].copy())
    weights = [
        savgol_coeffs(width, _ORDER, deriv=d, delta=1 / window.rate, use="dot")
        for d in range(3)
    ]
    moved = [_filtered(q, starts, w) for w in weights]
    torque = _filtered(tau, starts, weights[0])
    begins = ends == width - 1
    return (
        Tail(kept, total, tail.heard),
        Rows(t[starts + width - 1], *moved, torque, begins),
    )


_AT_ONCE = 1 << 13  # windows: their copies are larger than the samples


def _filtered(x: Array, starts: Array, weights: Array) -> Array:
    """Weighted sums over the windows that begin at some samples. Shape (m, dof)."""
    out = np.zeros((len(starts), x.shape[1]))
    if not len(starts):
        return out
    windows = np.lib.stride_tricks.sliding_window_view(x, len(weights), axis=0)
    for i in range(0, len(starts), _AT_ONCE):
        part = slice(i, i + _AT_ONCE)
        out[part] = np.einsum("mjw,w->mj", windows[starts[part]], weights)
    return out


def _none(dof: int) -> Rows:
    empty = (np.empty((0, dof)) for _ in range(4))
    return Rows(np.empty(0), *empty, np.empty(0, bool))
