"""Monitoring of sensors: calibrated on healthy runs, applied to others.

The paper mentions it (G2017, abstract) and leaves it open. T2 and SPE of its indicator
space detect no fault; errors do: measured minus reference position, measured minus model
torque. Each indicator of `KINDS` is divided by its limit; the largest ratio is the score
of a joint, and above 1 it is an alarm.
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

# The indicators of a monitor: per joint, a value each 16 ms for every kind of fault.
#
# All filters are windows of fixed length (Savitzky and Golay 1964). The time of a row is
# that of the last sample in its window, not of the middle, so alarms are causal.

_TINY = 1e-9


class ScoreKind(NamedTuple):
    """One indicator of each joint."""

    name: str
    sensor: str  # "encoder" or "torque"
    fault: str  # its fault


# The most specific first; from `BIAS` on errors are averaged over a window.
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
    """Signals of a log in rows of 16 ms, not yet compared with healthy ones."""

    t: Array  # time of the last sample of each row [s], (m,)
    rate: float  # rows per second [Hz]
    slow: Array  # the joint stands or has just stood: friction is unknown, (m, dof)
    gapless: Array  # no gap in its window, (m,), bool
    expected: Array  # torque of the model [N m], (m, dof)
    residual: Array  # residual [N m], (m, dof)
    # Measured minus reference position [rad]; zeros if not logged. (m, dof).
    tracking: Array
    # Maximum over the samples of each row: motion of the reference during an unchanged
    # reading [rad], number of unchanged samples, second difference of tracking [rad],
    # torque minus the median of its neighbours [N m]. (m, dof) each.
    raw: tuple[Array, ...]


def compute_monitor_signals(model: Model, recording: Recording) -> MonitorSignals:
    """Return the signals of a log.

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
    off = np.roll(off, spread, axis=0)  # a spike is detected with the samples after it
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
    # At standstill there is at most the information of motion.
    return np.array([moving, np.maximum(standing, moving)])


def compute_scores(log: MonitorSignals, size: Array) -> Array:
    """Return the indicators of `KINDS`, at least 0; larger is worse. Shape (k, m, dof).

    Errors x are averaged as |sum w f x| / sqrt(sum w f^2): the residual for f = 1 (a
    bias) and f = the expected torque (a scale, of which only a loss counts) with w = 1 /
    size^2, tracking for f = 1. `size` is the rms residual on healthy runs, moving and
    slow [N m], (2, dof).
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
    """Average a feature over a trailing window; 0 without excitation."""
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

    time: float  # time of the alarm, on the clock of the log [s]
    joint: int  # from 1
    sensor: str  # "encoder" or "torque"
    fault: str  # frozen, jump, drift, spikes, bias or lost scale
    kind: str  # the indicator that named it, of `KINDS`
    score: float  # that indicator over its limit, above 1
    until: float  # time at which the last score fell below its limit [s]


@dataclass(frozen=True, eq=False, slots=True)
class Monitor:
    """The typical signals of a healthy robot, and their limits."""

    model: Model  # predicts the torque
    rate: float  # rate of the logs [Hz]
    per_hour: float  # largest rate of false alarms, all kinds together
    hours: float  # length of the healthy runs [h]
    size: Array  # rms residual of healthy runs, moving and slow [N m], (2, dof)
    limits: Array  # limit of each indicator of `KINDS`, (k, dof)
    referenced: bool = True  # the reference position is logged and monitored

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
        """Return it as plain values, with its model; an infinite limit is null."""
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
    """Calibrate limits on runs of a healthy robot.

    Args:
        model: Predicts the torque; needs its ``speed_floor``. Its residual on healthy
            runs is the reference, so it should be fitted to them.
        recordings: Healthy runs, similar to the runs to monitor. At least three.
        per_hour: Largest rate of false alarms, all kinds together [1/h].

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
    # The rate of false alarms is divided among the kinds.
    probability = per_hour * MONITOR.block / 3600 / len(KINDS)
    limits = np.array([fit_score_limits(own, probability) for own in zip(*peaks, strict=True)])
    limits[BIAS:SCALE] *= MONITOR.wider_bias
    limits[SCALE:] *= MONITOR.wider_motion
    # A reading without noise is unchanged while its joint stands, however long.
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

    beta is the upper end of its confidence interval. Blocks of one run are similar, so no
    limit is below the predicted maximum of the next run either, by Student's t of the
    logarithms; few runs give wide limits. Joints are first scaled by the level that a
    twentieth of their blocks exceeds; the tail is that of the maximum over all joints,
    since they are strongly dependent. A block exceeds the limits with at most the wanted
    probability; they are infinite if the kind is always 0. Shapes (b, dof) to (dof,).
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
    """Join exceedances into alarms, and name them.

    A fault shows in several kinds: an encoder that jumps moves the arm, which needs
    torque on its neighbours too. The first exceedance starts the alarm; a second without
    any ends it, and so does a specific kind if none has named it.
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

    The most specific kind that exceeds its limit within a short time, else the largest
    averaged error.
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
    # A changed drive moves the arm: tracking adds nothing to torque.
    for kinds in (slice(BIAS, TRACKING), slice(TRACKING, None)):
        part = collected[kinds, first:later].max(axis=1)
        if part.max() > 0:
            k, j = np.unravel_index(np.argmax(part), part.shape)
            return int(kinds.start + k), int(j)
    raise AssertionError("an alarm without a crossing")


def _fault(log: MonitorSignals, values: Array, first: int, k: int, j: int) -> str:
    """Return the name of an averaged error: lost scale, drift or bias.

    A bias and a loss of scale look alike for a moment. They are compared on windows after
    the alarm, since half a window of either looks like neither. A drift is a ramp rather
    than a step near the alarm; each is fitted with any start row.
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
