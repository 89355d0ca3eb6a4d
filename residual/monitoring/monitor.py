"""Early warning of sensors that fail: calibrated on healthy runs, then watching others.

The paper wants it (G2017, abstract) and leaves it open. T2 and SPE of its indicator
space see no fault; what sees them are errors: measured minus wanted position, torque
minus that of the model. Each number of `KINDS` is divided by its limit; the largest of
them is the score of a joint, and above 1 it is an alarm.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

from residual.errors import InputError
from residual.model.model import Model
from residual.monitoring.thresholds import MONITOR
from residual.quantity import convert_to_plain_values
from residual.recording import Array, Recording
from residual.signals.track import estimate_sample_rate

# What a monitor looks at: per joint, a number each 16 ms for every kind of fault.
#
# All filters are windows of fixed length (Savitzky and Golay 1964). A row is stamped
# with the time of the last sample that it is made of, never with the middle of its
# window, so no alarm knows what comes after it.

_TINY = 1e-9


class ScoreKind(NamedTuple):
    """One number that is looked at for each joint."""

    name: str
    sensor: str  # "encoder" or "torque"
    fault: str  # what it looks for


# The surest first; from `BIAS` on errors are collected over a window.
KINDS = (
    ScoreKind("frozen", "encoder", "frozen"),
    ScoreKind("still", "encoder", "frozen"),
    ScoreKind("jump", "encoder", "jump"),
    ScoreKind("spikes", "torque", "spikes"),
    ScoreKind("bias", "torque", "bias"),
    ScoreKind("scale", "torque", "lost scale"),
    ScoreKind("tracking", "encoder", "bias"),
)
STILL, BIAS, SCALE, TRACKING = 1, 4, 5, 6


@dataclass(frozen=True, eq=False, slots=True)
class MonitorSignals:
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


def compute_monitor_signals(model: Model, recording: Recording) -> MonitorSignals:
    """Return what is seen of a log.

    Raises:
        InputError: If it is shorter than a second, or so slow that a window of 60 ms
            has fewer than five samples.
    """
    rate = estimate_sample_rate(recording.t)
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
    return MonitorSignals(
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
    """Return `MonitorSignals.raw` of each sample, across gaps too. (n, dof)."""
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


def residual_rms(logs: Sequence[MonitorSignals]) -> Array:
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


def compute_scores(log: MonitorSignals, size: Array) -> Array:
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
    rows = max(2, round(MONITOR.window * log.rate))
    return np.array(
        [
            *(travel, count, bend, off),
            np.abs(_matched(weight, log.residual, one, rows)),
            _matched(weight, -log.residual, log.expected, rows).clip(0),
            np.abs(_matched(gapless, log.tracking, one, rows)),
        ]
    )


def _matched(weight: Array, x: Array, f: Array, count: int) -> Array:
    """Collect a feature over a trailing window; 0 where nothing was to be seen."""
    over, under = _trailing(weight * f * x, count), _trailing(weight * f * f, count)
    seen = under > _TINY
    return over / np.sqrt(np.where(seen, under, 1.0)) * seen


def _trailing(x: Array, count: float) -> Array:
    """Sum over the last rows, fewer at the beginning. Shape (m, dof)."""
    total, count = np.cumsum(x, axis=0), round(count)
    return total - np.vstack([np.zeros((count, x.shape[1])), total])[: len(x)]


LEAST_RUNS = 3


@dataclass(frozen=True, slots=True)
class Alarm:
    """One alarm."""

    time: float  # when it was raised, on the clock of the log [s]
    joint: int  # from 1
    sensor: str  # "encoder" or "torque"
    fault: str  # frozen, jump, drift, spikes, bias or lost scale
    kind: str  # the number that named it, of `KINDS`
    score: float  # that number over its limit, above 1
    until: float  # when the last score fell below its limit [s]


@dataclass(frozen=True, eq=False, slots=True)
class Monitor:
    """What is usual on a robot in good order, and the limits of that."""

    model: Model  # expects the torque
    rate: float  # rate of the logs [Hz]
    per_hour: float  # false alarms wanted at most, all kinds together
    hours: float  # length of the healthy runs [h]
    size: Array  # what is usual of the residual, moving and slow [N m], (2, dof)
    limits: Array  # limit of each number of `KINDS`, (k, dof)
    referenced: bool = True  # the wanted position is logged, and looked at

    def watch(self, recording: Recording) -> tuple[Alarm, ...]:
        """Return the alarms of a log, in the order of time.

        Raises:
            InputError: If it is of another robot or rate, or too short.
        """
        _check_log(recording, self.model, self.rate)
        if not self.referenced:
            recording = replace(recording, q_ref=None)
        elif recording.q_ref is None:
            raise InputError(
                f"{recording.id} has no q_ref, the runs of the calibration have it. "
                "Log the reference, or calibrate on runs without it."
            )
        log = compute_monitor_signals(self.model, recording)
        return _alarms(log, compute_scores(log, self.size), self.limits)

    def to_record(self) -> dict:
        """Return it as plain values, with its model; a limit never reached is null."""
        names = ("rate", "per_hour", "hours", "referenced", "size")
        limits = {k.name: own for k, own in zip(KINDS, self.limits, strict=True)}
        return {
            "form": 2,
            "robot": self.model.robot.name,
            "model": self.model.to_record(),
            **convert_to_plain_values({name: getattr(self, name) for name in names}),
            "limits": convert_to_plain_values(limits),
        }


def calibrate_monitor(
    model: Model, recordings: Sequence[Recording], per_hour: float = 1.0
) -> Monitor:
    """Learn from runs of a robot in good order what is usual, and set limits.

    Args:
        model: Expects the torque; needs its ``speed_floor``. What it leaves of healthy
            runs is what is usual: best it is fitted to them.
        recordings: Healthy runs, such as will be watched later. At least three.
        per_hour: False alarms wanted at most, all kinds together [1/h].

    Raises:
        InputError: If there are fewer than three runs, or one does not fit the others.
    """
    if len(recordings) < LEAST_RUNS:
        raise InputError(
            f"{len(recordings)} runs to calibrate on, expected at least {LEAST_RUNS}: "
            "limits are set by how runs differ. Give more runs of the good robot."
        )
    if not 0 < per_hour < np.inf:
        raise InputError(f"{per_hour:g} false alarms per hour, expected more than 0.")
    if model.speed_floor is None:
        raise InputError("The model has no speed_floor; make it from logs first.")
    rate = estimate_sample_rate(recordings[0].t)
    for run in recordings:
        _check_log(run, model, rate)
    referenced = all(run.q_ref is not None for run in recordings)
    runs = [r if referenced else replace(r, q_ref=None) for r in recordings]
    logs = [compute_monitor_signals(model, run) for run in runs]
    size = residual_rms(logs)
    peaks = [maxima_per_block(log.t, compute_scores(log, size)) for log in logs]
    # The false alarms are shared among the kinds.
    probability = per_hour * MONITOR.block / 3600 / len(KINDS)
    limits = np.array([fit_score_limits(own, probability) for own in zip(*peaks, strict=True)])
    limits[BIAS:SCALE] *= MONITOR.wider_bias
    limits[SCALE:] *= MONITOR.wider_motion
    # A reading without noise rests while its joint does, however long that is.
    limits[STILL, limits[STILL] > MONITOR.still * rate] = np.inf
    return Monitor(
        model=model,
        rate=rate,
        per_hour=per_hour,
        hours=sum(run.duration for run in runs) / 3600.0,
        size=size,
        limits=limits,
        referenced=referenced,
    )


def _check_log(recording: Recording, model: Model, rate: float) -> None:
    """Check that a log is of the robot and rate of a monitor."""
    dof = model.robot.dof
    if recording.dof != dof:
        raise InputError(
            f"{recording.id} has {recording.dof} joints, the monitor is for {dof}. "
            "Give a run of the same robot."
        )
    own = estimate_sample_rate(recording.t)
    if abs(own - rate) > 0.01 * rate:
        raise InputError(
            f"{recording.id} is logged at {own:g} Hz, the monitor is calibrated at "
            f"{rate:g} Hz. Calibrate it on runs of that rate."
        )


def maxima_per_block(t: Array, values: Array) -> Array:
    """Return the largest value of each block of time. (k, m, dof) to (k, b, dof)."""
    block = ((t - t[0]) // MONITOR.block).astype(int)
    return np.maximum.reduceat(values, np.flatnonzero(np.diff(block, prepend=-1)), 1)


def fit_score_limits(runs: Sequence[Array], probability: float) -> Array:
    """Return the limits of one kind, from its maxima of blocks on healthy runs.

    Neighbouring values are nearly the same; blocks of some seconds are nearly
    independent. Over a high threshold u their maxima decay about exponentially (peaks
    over threshold: Davison & Smith 1990):

    P(M > u + x) = share exp(-x / beta),   limit = u + beta log(share / wanted)

    beta is taken at the upper end of its confidence. Blocks of one run are alike in
    what the run is like, so no limit is below what the largest value of the next run
    may be either, by Student's t of the logarithms; few runs make wide limits. Joints
    are brought to one size first, by the level that a twentieth of their blocks
    exceeds; the tail is that of the largest of all joints, since they are anything but
    independent. A block exceeds the limits with the wanted probability, at most; they
    are infinite where the kind never left 0. Shapes (b, dof) to (dof,).
    """
    peaks, count = np.vstack(runs), len(runs)
    level = np.quantile(peaks, 0.95, axis=0)
    level = np.maximum(level, 1e-6 * max(level.max(), _TINY))
    largest = (peaks / level).max(axis=1)
    threshold = float(np.quantile(largest, 1.0 - MONITOR.tail))
    above = largest[largest > threshold] - threshold
    limit = MONITOR.margin * float(largest.max())
    if len(above):
        beta = float(above.mean()) * (1.0 + MONITOR.sure / np.sqrt(len(above)))
        share = len(above) / len(largest)
        further = beta * max(0.0, float(np.log(share / probability)))
        limit = max(limit, threshold + further)
    each = np.log([max(float((run / level).max()), _TINY) for run in runs])
    sure = float(stdtrit(count - 1, 1.0 - min(probability * len(peaks) / count, 0.5)))
    further = each.mean() + sure * each.std(ddof=1) * np.sqrt(1 + 1 / count)
    limit = max(limit, float(np.exp(further)))
    return np.where(peaks.max(axis=0) > 0, level * limit, np.inf)


def _alarms(log: MonitorSignals, values: Array, limits: Array) -> tuple[Alarm, ...]:
    """Join what is over its limit to alarms, and name them.

    A fault shows in several kinds: an encoder that jumps moves the arm, which takes
    torque on its neighbours too. The first to cross opens the alarm; a second of quiet
    ends it, and so does a sure kind where none has named it.
    """
    t, ratio = log.t, values / limits[:, None]
    over = (ratio > 1).any(axis=2)
    sure, rows, out = over[:BIAS].any(axis=0), np.flatnonzero(over.any(axis=0)), []
    while len(rows):
        first = rows[0]
        last = rows[np.argmax(np.append(np.diff(t[rows]) > MONITOR.quiet, True))]
        soon = np.searchsorted(t, t[first] + MONITOR.together, "right")
        news = soon + np.flatnonzero(sure[soon : last + 1])
        if len(news) and not sure[first:soon].any():
            last = rows[np.searchsorted(rows, news[0]) - 1]
        k, j = _named(t, ratio, values, first, last + 1)
        fault = KINDS[k].fault if k < BIAS else _fault(log, values, first, k, j)
        size = float(ratio[k, first : last + 1, j].max())
        about = j + 1, KINDS[k].sensor, fault, KINDS[k].name, size
        out.append(Alarm(float(t[first]), *about, float(t[last])))
        rows = rows[rows > last]
    return tuple(out)


def _named(t: Array, ratio: Array, values: Array, first: int, stop: int) -> tuple[int, int]:
    """Return the kind and the joint from 0 that name an alarm of some rows.

    The surest kind that crosses within the next moment, else the collected error that
    is largest of all.
    """
    soon, later = (
        min(int(np.searchsorted(t, t[first] + wait, "right")), stop)
        for wait in (MONITOR.together, MONITOR.later)
    )
    for fault in ("frozen", "jump", "spikes"):
        kinds = [k for k, kind in enumerate(KINDS) if kind.fault == fault]
        part = ratio[kinds, first:soon].max(axis=1)
        if part.max() > 1:
            k, j = np.unravel_index(np.argmax(part), part.shape)
            return kinds[k], int(j)
    collected = values * (ratio > 1)
    # A drive that is not what it was moves the arm: tracking is no news beside torque.
    for kinds in (slice(BIAS, TRACKING), slice(TRACKING, None)):
        part = collected[kinds, first:later].max(axis=1)
        if part.max() > 0:
            k, j = np.unravel_index(np.argmax(part), part.shape)
            return int(kinds.start + k), int(j)
    raise AssertionError("an alarm without a crossing")


def _fault(log: MonitorSignals, values: Array, first: int, k: int, j: int) -> str:
    """Return the name of a collected error: lost scale, drift or bias.

    A bias and a loss of scale are alike for a moment. They are compared on windows that
    lie after the alarm: half a window of either looks like neither. A drift is rather
    a ramp than a step about the alarm; each is fitted from any row on.
    """
    start, until = log.t[first], log.t[first] + MONITOR.later
    after = (log.t >= start + MONITOR.window) & (log.t <= until)
    bias, scale = (np.square(values[kind, after, j]).sum() for kind in (BIAS, SCALE))
    if k < TRACKING and scale > bias:
        return "lost scale"
    error = (log.residual if k < TRACKING else log.tracking)[:, j]
    about = slice(*np.searchsorted(log.t, (start - MONITOR.back, until)))
    # Sums of x and of x (i - k) over the rows i from k on, k from the last row back.
    step = np.cumsum(error[about][::-1])
    ramp = (np.cumsum(step) - step)[1:]
    count = np.arange(1, len(step) + 1.0)
    as_ramp = (ramp**2 / np.cumsum(count[:-1] ** 2)).max(initial=0.0)
    return "drift" if as_ramp > (step**2 / count).max() else "bias"
