"""What logs are filtered by and cut into, and what friction does at standstill.

At standstill Coulomb friction is set-valued. A log's torque then shows which value
the drive and the gear left behind: the sign of creep, the sign of the last motion
(a bristle that holds), or nothing on average. No fit uses such rows; predictions
need an answer all the same.
"""

import mmap
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from itertools import groupby, pairwise
from typing import Literal

import numpy as np

from residual.recording import Array, Recording


@dataclass(frozen=True, slots=True)
class Standstill:
    """How the direction of motion passes through zero."""

    # "smooth": tanh(qd / (size · floor)). "bristle": Dahl's state of that displacement
    # [rad] (Dahl 1968), where 0 is the plain sign of velocity.
    kind: Literal["smooth", "bristle"] = "smooth"
    size: float = 0.25  # number of its kind
    hold: float = 1.0  # share of it that remains while the joint stands, 0 to 1
    reach: float = 1.0  # speed up to which it counts as standing here, in floors


SMOOTH = Standstill()
CHOICES = (
    SMOOTH,
    Standstill("smooth", 1.0),
    Standstill("smooth", 4.0),
    *(
        Standstill("bristle", d, reach=r)
        for d in (0.0, 3e-5, 1e-4, 3e-4, 1e-3, 1e-2)
        for r in (1.0, 4.0)
    ),
)


def direction(q: Array, qd: Array, floor: float, shape: Standstill) -> Array:
    """Direction of motion of one joint, -1 to 1, with its behaviour at standstill.

    Args:
        floor: Speed under which the joint counts as standing [rad/s].
    """
    if shape.kind == "smooth":
        out = np.tanh(qd / (shape.size * floor))
    elif shape.size == 0.0:
        out = np.sign(qd)
    else:
        out = bristle(q, shape.size)
    if shape.hold == 1.0:
        return out
    return np.where(np.abs(qd) < shape.reach * floor, shape.hold, 1.0) * out


def bristle(q: Array, displacement: float) -> Array:
    """Dahl's state by its exact solution over each step of position, start at rest.

    Each step is z -> fade z + (1 - fade) goal. Two such steps in a row make one of the
    same kind, so after log2(n) rounds of joining each with those before it every
    sample has its whole past. From -1 to 1; it yields over the displacement [rad].
    """
    step = np.diff(q)
    fade = np.exp(-np.abs(step) / displacement)
    state = np.where(step > 0, 1.0, -1.0) * (1 - fade)
    reach = 1
    while reach < len(step) and fade.any():
        state[reach:] += fade[reach:] * state[:-reach]
        fade[reach:] *= fade[:-reach]
        fade[:reach] = 0.0  # at rest before
        reach *= 2
    return np.concatenate([np.zeros(min(len(q), 1)), np.clip(state, -1, 1)])


def directions(
    q: Array, qd: Array, floor: Array, shapes: tuple[Standstill, ...]
) -> Array:
    """Direction of motion of every joint. Shapes (n, dof), (dof,), one per joint."""
    pairs = zip(q.T, qd.T, floor, shapes, strict=True)
    return np.column_stack([direction(*p) for p in pairs])


# The zero-phase low-pass, every k-th value of it as one product; power spectra.
#
# Written out here since `scipy.signal`, with all that it brings, takes longer to import
# than most logs take to be diagnosed.


ORDER = 4  # of the Butterworth filter, which runs forwards and backwards
REACH = 4.5  # periods of the cut-off after which it has forgotten all but 1e-5
BLOCK = 16  # rows that are made at once
_HARRIS = (0.35875, 0.48829, 0.14128, 0.01168)  # Blackman-Harris, four terms


def low_pass(
    x: Array,
    cutoff: float,
    rate: float,
    step: int = 1,
    ahead: float = 0.0,
    order: int = 0,
) -> Array:
    """Butterworth low-pass of order 4, forwards and backwards, along the first axis.

    As a product with the filter's own impulse response: what is thrown away is not
    made. Beyond its ends the signal goes on turned about its last value.

    Args:
        x: Signals. Shape (n, ...).
        cutoff: Of the low-pass [Hz].
        rate: Of the signals [Hz].
        step: Which values are wanted: 0, step, 2 step, ...
        ahead: Time by which the values are of a later signal [s].
        order: Of the time derivative that is wanted, by central differences; above 0
            the cut-off must be well below half of the rate.

    Returns:
        Shape (ceil(n / step), ...).
    """
    x = np.asarray(x, dtype=float)
    if cutoff >= 0.45 * rate and not ahead:
        return x[::step]
    band, reach = _band(cutoff, rate, step, ahead, order)
    rows = -(-len(x) // step)
    blocks = -(-rows // BLOCK)
    flat = x.reshape(len(x), -1).T  # time last: a signal lies together
    longer = _with_ends(flat, reach, (blocks - 1) * BLOCK * step + len(band))
    out = np.empty((len(flat), blocks * BLOCK))
    for b in range(blocks):
        first, row = b * BLOCK * step, b * BLOCK
        out[:, row : row + BLOCK] = longer[:, first : first + len(band)] @ band
    return out[:, :rows].T.reshape(rows, *x.shape[1:])


def _with_ends(x: Array, reach: int, length: int) -> Array:
    """The signal from ``reach`` before its start on, to the length asked for."""
    n = x.shape[1]
    ends, first, last = min(reach, n - 1), x[:, :1], x[:, -1:]
    out = np.empty((len(x), length))
    out[:, reach : reach + n] = x
    out[:, reach - ends : reach] = 2 * first - x[:, ends:0:-1]
    out[:, : reach - ends] = out[:, [reach - ends]]
    stop = min(reach + n + ends, length)
    after = x[:, n - 1 - (stop - reach - n) : n - 1]
    out[:, reach + n : stop] = 2 * last - after[:, ::-1]
    out[:, stop:] = out[:, [stop - 1]]
    return out


@cache
def _band(
    cutoff: float, rate: float, step: int, ahead: float, order: int
) -> tuple[Array, int]:
    """What makes a block of rows of the samples around it, and how far it reaches."""
    reach = int(np.ceil((REACH / cutoff + abs(ahead)) * rate))
    taps = _impulse_response(cutoff, rate, reach, ahead)
    for _ in range(order):  # d/dt of the output: the response differenced, turned
        taps = np.convolve(taps, [-rate / 2, 0.0, rate / 2])
    reach += order
    band = np.zeros(((BLOCK - 1) * step + len(taps), BLOCK))
    for row in range(BLOCK):
        band[row * step : row * step + len(taps), row] = taps
    return band, reach


def _impulse_response(cutoff: float, rate: float, reach: int, ahead: float) -> Array:
    """Values from -reach to reach. The filter is |H|^2, in closed form.

    1 / (1 + (tan(w / 2) / tan(w_c / 2))^(2 N))    (bilinear transform, w in rad/sample)
    """
    half = np.linspace(0, np.pi / 2, 4 * reach + 1)[:-1]  # at pi it is zero
    warped = np.tan(half) / np.tan(np.pi * min(cutoff / rate, 0.49))
    gain = np.exp(-2j * half * ahead * rate) / (1 + warped ** (2 * ORDER))
    pulse = np.fft.irfft(np.append(gain, 0.0))
    taps = np.concatenate([pulse[-reach:], pulse[: reach + 1]])
    return taps / taps.sum()


def power_density(x: Array, length: int, robust: bool = False) -> tuple[Array, Array]:
    """Power per share of the sampling rate, of segments that overlap by half.

    By averaged periodograms (Welch 1967).

    Args:
        x: Signals. Shape (n, k), n at least the length.
        length: Samples of a segment; its mean is taken out.
        robust: Take the median of the segments instead of their mean.

    Returns:
        Frequencies as shares of the sampling rate, and densities [x^2]. Shapes (f,),
        (f, k).
    """
    turn = 2 * np.pi * np.arange(length) / length
    terms = (a * (-1) ** i * np.cos(i * turn) for i, a in enumerate(_HARRIS))
    window = np.sum(list(terms), axis=0)
    parts = np.lib.stride_tricks.sliding_window_view(x, length, axis=0)
    parts = parts[:: max(length // 2, 1)]
    parts = (parts - parts.mean(axis=-1, keepdims=True)) * window
    power = np.abs(np.fft.rfft(parts)) ** 2 / (window**2).sum()
    # The median of a squared normal is short of its mean by the logarithm of 2.
    middle = np.median(power, axis=0) / np.log(2) if robust else power.mean(axis=0)
    return np.fft.rfftfreq(length), 2 * middle.T


def randomise_phases(spectrum: Array, rows: int, rng: np.random.Generator) -> Array:
    """Return signals of given one-sided spectra with independent random phases.

    Mean and amplitude at every frequency are kept. (rows // 2 + 1, k) to (rows, k).
    """
    turn = np.exp(2j * np.pi * rng.random(spectrum.shape))
    # Mean and, for an even length, the highest frequency must stay real.
    turn[0] = 1
    if rows % 2 == 0:
        turn[-1] = np.sign(turn[-1].real)
    return np.fft.irfft(spectrum * turn, n=rows, axis=0)


# Long logs, cut into pieces that are worked through one after the other.
#
# A log of an hour would take gigabytes: the regressor of its motion alone has 360
# numbers a row. What a fit needs of it are sums over rows, and these may be taken piece
# by piece. Pieces overlap by what is dropped at their ends, and the filter forgets
# within that: the rows of the pieces are those of the whole. They keep the id of their
# log.


LONG = 600.0  # s of logs in all from which on they are cut
CUTOFF = 8.0  # Hz, of the identification filter; lower for slow logs
MANY = 300_000  # samples likewise: memory goes with them
PIECE = 60.0  # s
FORGETS = 8.0  # periods of the identification filter that are dropped at the ends
SKETCH = 420.0  # s of long logs that are kept whole, for what no sum can tell
# So that no piece lies in two folds of a log (evidence/design.py).
_MULTIPLE = 6


def in_pieces(
    recordings: Sequence[Recording], cutoff: float = CUTOFF
) -> tuple[Recording, ...]:
    """Cut the logs, where they are long.

    Returns:
        The logs, or in place of each of two minutes or more its pieces, in order.
    """
    if not are_long(recordings):
        return tuple(recordings)
    return tuple(piece for r in recordings for piece in _pieces(r, cutoff))


def are_long(recordings: Sequence[Recording]) -> bool:
    """Whether logs are more than ten minutes, or 300 000 samples, in all."""
    samples = sum(len(r.t) for r in recordings)
    return samples > MANY or sum(r.duration for r in recordings) > LONG


def _pieces(recording: Recording, cutoff: float) -> tuple[Recording, ...]:
    count = _MULTIPLE * round(recording.duration / PIECE / _MULTIPLE)
    if count < 2:
        return (recording,)
    n = len(recording.t)
    rate = (n - 1) / recording.duration
    # The rows of a slow log come from a slower filter (``Filters.cutoff``).
    over = round(overlap(min(cutoff, 0.08 * rate), rate) * rate)
    edges = np.linspace(0, n, count + 1).astype(int)
    return tuple(
        rows_of(recording, max(a - over, 0), min(b + over, n))
        for a, b in pairwise(edges)
    )


def overlap(cutoff: float, rate: float) -> float:
    """How far a piece reaches beyond its own part of the log, at both ends [s]."""
    return float(np.ceil(FORGETS / cutoff * rate)) / rate


def rows_of(recording: Recording, first: int, last: int) -> Recording:
    """Return the samples from ``first`` up to ``last`` of a log, without a copy."""
    arrays = {f.name: getattr(recording, f.name) for f in fields(recording)[2:]}
    own = {k: x[first:last] for k, x in arrays.items() if x is not None}
    return replace(recording, **own)


def sketch_of(
    recordings: Sequence[Recording],
    most: float | None = None,
    kept: float | None = None,
) -> Sequence[Recording]:
    """Return pieces, evenly spread, of long logs; the logs where they are not long.

    Args:
        most: From how many seconds on they are long; ten minutes where None.
        kept: Seconds that are kept of them; seven minutes where None.
    """
    most = LONG if most is None else most
    if not are_long(recordings) and sum(r.duration for r in recordings) <= most:
        return recordings
    pieces = [piece for r in recordings for piece in _pieces(r, CUTOFF)]
    return [pieces[i] for i in spread([r.duration for r in pieces], most, kept)]


def let_go(recording: Recording) -> None:
    """Let samples that lie in a file go from memory; they come back when read."""
    for array in (recording.q, recording.tau):
        while isinstance(array, np.ndarray):
            array = array.base
        if isinstance(array, mmap.mmap):
            array.madvise(mmap.MADV_DONTNEED)


def cut(ids: Sequence[str]) -> list[bool]:
    """Of each of several logs whether it is a piece of one: its id comes again."""
    return [ids.count(own) > 1 for own in ids]


def logs_of(ids: Sequence[str]) -> list[list[int]]:
    """Numbers of the pieces of each log, by their ids."""
    by_id = groupby(range(len(ids)), key=lambda i: ids[i])
    return [list(numbers) for _, numbers in by_id]


def is_cut(seconds: Sequence[float]) -> bool:
    """Whether logs are too long to be kept whole, by the length of each [s]."""
    return len(spread(seconds)) < len(seconds)


def spread(
    seconds: Sequence[float], most: float | None = None, kept: float | None = None
) -> list[int]:
    """Choose pieces, evenly spread, of long logs, by number; of short ones all.

    Args:
        seconds: Length of each piece [s].
        most: From how many seconds in all on a choice is made; ten minutes where None.
        kept: How many are chosen; seven minutes where None.
    """
    total = float(sum(seconds))
    if total <= (LONG if most is None else most):
        return list(range(len(seconds)))
    middle = np.cumsum(seconds) - 0.5 * np.asarray(seconds)
    count = max(int((SKETCH if kept is None else kept) / max(seconds)), 1)
    wanted = (np.arange(count) + 0.5) / count * total
    return sorted({int(np.argmin(np.abs(middle - at))) for at in wanted})


def session_clock(recordings: Sequence[Recording]) -> float | None:
    """Start of the session if the logs' times show their order, else None [s]."""
    spans = sorted((float(r.t[0]), float(r.t[-1])) for r in recordings)
    ordered = all(a[1] < b[0] for a, b in pairwise(spans))
    return spans[0][0] if ordered else None


def hold_out_end(
    fit: Sequence[Recording],
) -> tuple[list[Recording], list[Recording]]:
    """Cut the last quarter off the longest log and hold it out."""
    longest = max(fit, key=lambda r: r.duration)
    cut = longest.t[0] + 0.75 * longest.duration
    row = int(np.searchsorted(longest.t, cut))
    head, tail = rows_of(longest, 0, row), rows_of(longest, row, len(longest.t))
    tail = replace(tail, id=f"{longest.id} (last quarter)")
    return [head if r is longest else r for r in fit], [tail]
