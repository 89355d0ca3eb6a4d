"""What a monitor looks at: per joint, a number each 16 ms for every kind of fault.

All filters are windows of fixed length (Savitzky and Golay 1964). A row is stamped with
the time of the last sample that it is made of, never with the middle of its window, so
no alarm knows what comes after it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from residual.errors import InputError
from residual.model.model import Model
from residual.monitoring.thresholds import MONITOR
from residual.recording import Array, Recording
from residual.signals.track import sample_rate

_TINY = 1e-9


class Kind(NamedTuple):
    """One number that is looked at for each joint."""

    name: str
    sensor: str  # "encoder" or "torque"
    fault: str  # what it looks for


# The surest first; from `BIAS` on errors are collected over 0.25 and over 1 s.
KINDS = (
    Kind("frozen", "encoder", "frozen"),
    Kind("still", "encoder", "frozen"),
    Kind("encoder noise", "encoder", "noise"),
    Kind("torque noise", "torque", "noise"),
    Kind("jump", "encoder", "jump"),
    Kind("spikes", "torque", "spikes"),
    *(Kind(name, "torque", "bias") for name in ("bias", "long bias")),
    *(Kind(name, "torque", "lost scale") for name in ("scale", "long scale")),
    *(Kind(name, "encoder", "bias") for name in ("tracking", "long tracking")),
)
STILL, BIAS, SCALE, TRACKING = 1, 6, 8, 10


@dataclass(frozen=True, eq=False, slots=True)
class Sight:
    """What is seen of a log, by rows of 16 ms, not yet compared with healthy ones."""

    t: Array  # time of the last sample of each row [s], (m,)
    rate: float  # rows per second [Hz]
    slow: Array  # the joint stands or has just stood: friction is not known, (m, dof)
    gapless: Array  # no gap in its window, (m,), bool
    expected: Array  # torque of the model [N m], (m, dof)
    residual: Array  # measured minus that [N m], (m, dof)
    # Measured minus wanted position [rad]; zeros where that is not logged. (m, dof).
    tracking: Array
    # The largest of the samples of each row: how far the wanted position came while a
    # reading rested [rad], for how many samples it rested, second difference of
    # tracking [rad], torque minus the median of its neighbors [N m]. (m, dof) each.
    raw: tuple[Array, ...]


def sight_of(model: Model, recording: Recording) -> Sight:
    """Return what is seen of a log.

    Raises:
        InputError: If it is shorter than a second, or so slow that a window of 60 ms
            has fewer than five samples.
    """
    rate = sample_rate(recording.t)
    half, step = round(MONITOR.half * rate), max(1, round(MONITOR.step * rate))
    if half < 2:
        raise InputError(
            f"{recording.id} is logged at {rate:g} Hz, expected at least 60 Hz "
            "to watch sensors. Log faster, or leave it out."
        )
    if recording.duration < MONITOR.shortest:
        raise InputError(
            f"{recording.id} lasts {recording.duration:g} s, expected at least "
            f"{MONITOR.shortest:g} s. Give a longer log."
        )
    t, goal, width = recording.t, recording.q_ref, 2 * half + 1
    ends = np.arange(2 * half, len(t), step)

    def rows(x: Array, times: int = 0) -> Array:
        """Return a derivative in the middle of the window of each row. (m, dof)."""
        from scipy.signal import savgol_filter

        order = MONITOR.order
        return savgol_filter(x, width, order, times, 1 / rate, axis=0)[ends - half]

    late = np.diff(t, prepend=t[0]) > MONITOR.gap / rate
    gone = np.cumsum(late)
    q, qd, qdd = (rows(recording.q, times) for times in range(3))
    slow = (np.abs(qd) < MONITOR.slow * model.speed_floor).astype(float)
    clock = t[ends[0]] if model.clock is None else model.clock
    seen = model.state(rate / step, t[ends] - clock, (q, qd, qdd))
    expected = model.torque_seen(seen)
    first, last = np.concatenate([[0], ends[:-1] + 1]), ends[-1] + 1
    raw = (x[:last] for x in _raw(recording, late))
    return Sight(
        t=t[ends],
        rate=rate / step,
        slow=_trailing(slow, MONITOR.memory * rate / step) > 0,
        gapless=gone[ends] == gone[ends - 2 * half],
        expected=expected,
        residual=rows(recording.tau) - expected,
        tracking=np.zeros(q.shape) if goal is None else rows(recording.q - goal),
        raw=tuple(np.maximum.reduceat(x, first, axis=0) for x in raw),
    )


def _raw(recording: Recording, late: Array) -> tuple[Array, ...]:
    """What is seen of each sample, as `Sight.raw` has it, but across gaps. (n, dof)."""
    from scipy.ndimage import median_filter

    q, tau, spread = recording.q, recording.tau, MONITOR.spread
    goal = np.zeros(q.shape) if recording.q_ref is None else recording.q_ref
    row = np.arange(len(q))[:, None]
    rests = np.diff(q, axis=0, prepend=np.nan) == 0
    since = np.maximum.accumulate(np.where(rests, 0, row), axis=0)
    travel = np.abs(goal - np.take_along_axis(goal, since, axis=0))
    bend = np.abs(np.diff(q - goal, 2, axis=0, prepend=np.zeros((2, q.shape[1]))))
    bend[:2] = bend[late] = bend[1:][late[:-1]] = 0.0
    off = np.abs(tau - median_filter(tau, (2 * spread + 1, 1), mode="nearest"))
    off = np.roll(off, spread, axis=0)  # a spike is known when the samples after it are
    off[:spread] = 0.0
    return travel, (row - since).astype(float), bend, off


def usual_size(logs: Sequence[Sight]) -> Array:
    """Return the root mean square of the residual, moving and slow [N m]. (2, dof)."""
    x = np.vstack([log.residual for log in logs])
    slow = np.vstack([log.slow for log in logs])
    use = np.concatenate([log.gapless for log in logs])[:, None]
    moving, standing = (
        np.sqrt((x**2 * own).sum(axis=0) / np.maximum(own.sum(axis=0), 1))
        for own in (~slow & use, slow & use)
    )
    moving = np.maximum(moving, 1e-3 * max(float(moving.max()), _TINY))
    # Standing tells less than moving, never more.
    return np.array([moving, np.maximum(standing, moving)])


def scores_of(log: Sight, size: Array) -> Array:
    """Return the numbers of `KINDS`, at least 0; larger is worse. Shape (k, m, dof).

    Errors x are collected as |sum w f x| / sqrt(sum w f^2): the residual for f = 1 (a
    bias) and f = the expected torque (a scale, of which only a loss counts) by w = 1 /
    size^2, tracking for f = 1. `size` is that of the residual on healthy runs, moving
    and slow [N m], (2, dof).
    """
    travel, count, bend, off = log.raw
    one = np.ones(off.shape)
    gapless = log.gapless[:, None] * one
    weight = gapless / np.where(log.slow, size[1], size[0]) ** 2
    windows = [max(2, round(seconds * log.rate)) for seconds in MONITOR.windows]
    return np.array(
        [
            *(travel, count, _level(bend, windows[0]), _level(off, windows[0])),
            *(bend, off),
            *(np.abs(_matched(weight, log.residual, one, n)) for n in windows),
            *(
                _matched(weight, -log.residual, log.expected, n).clip(0)
                for n in windows
            ),
            *(np.abs(_matched(gapless, log.tracking, one, n)) for n in windows),
        ]
    )


def _level(x: Array, count: int) -> Array:
    """Return the median of the last rows, which no single spike lifts. (m, dof)."""
    from scipy.ndimage import median_filter

    before = np.vstack([np.zeros((count, x.shape[1])), x])
    return median_filter(before, (count, 1), origin=((count - 1) // 2, 0))[count:]


def _matched(weight: Array, x: Array, f: Array, count: int) -> Array:
    """Collect a feature over trailing windows; 0 where nothing was to be seen."""
    over, under = _trailing(weight * f * x, count), _trailing(weight * f * f, count)
    seen = under > _TINY
    return over / np.sqrt(np.where(seen, under, 1.0)) * seen


def _trailing(x: Array, count: float) -> Array:
    """Sum over the last rows, fewer at the beginning. Shape (m, dof)."""
    total, count = np.cumsum(x, axis=0), round(count)
    return total - np.vstack([np.zeros((count, x.shape[1])), total])[: len(x)]
