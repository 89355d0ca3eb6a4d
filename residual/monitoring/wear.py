"""Wear or warmth: friction that moves from day to day, or within the day.

A joint's friction in log i is y_i = a + b exp(-s_i / T) + c d_i + e_i, where s_i is the
time since its session began and d_i the days since the first log: b is what warming up
takes off, with the time T that all joints share, c is wear. The scatter e is
estimated from the logs themselves, so whatever else differs between them widens the
intervals (ordinary least squares with Student's t, Draper and Smith 1998, ch. 1 and 5).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import t as student

from residual.errors import InputError
from residual.evidence.design import LAGS
from residual.evidence.fit import autocorrelation_time
from residual.model.model import Model
from residual.model.nominal import prepare_logs
from residual.monitoring.rules import MONITOR
from residual.recording import Array, Recording
from residual.robot.robot import Robot
from residual.signals.track import Filters, Track

TIMES = np.geomspace(60.0, 7200.0, 25)  # s: time constants that are tried


@dataclass(frozen=True, slots=True)
class Rate:
    """A change and its interval."""

    value: float  # relative change: of wear per 30 days, of warming from cold to warm
    # Ends of the interval that holds it with 95 %.
    low: float
    high: float
    real: bool  # it is told from none, at one in a hundred over all joints


@dataclass(frozen=True, slots=True)
class JointTrend:
    """What the friction of one joint does."""

    joint: int  # joint number from 1
    logs: int  # logs that tell something of it
    wear: Rate | None  # per 30 days; None where the logs cannot tell
    warming: Rate | None  # from cold to warm; None where the logs cannot tell
    why: str = ""  # why not, empty where both are told


def trends(change: Array, day: Array, session: Array) -> tuple[list[JointTrend], float]:
    """Tell wear from warming up for every joint.

    Args:
        change: Relative change of friction in each log. Shape (n, dof); NaN if unknown.
        day: Days since the first log. Shape (n,).
        session: Time since the session of that log began [s]. Shape (n,).

    Returns:
        A trend per joint, which holds with every time constant of warming up that
        explains the logs about as well; and the one that explains them best [s].

    Raises:
        InputError: If the logs are too few.
    """
    change, day, session = (np.asarray(x, dtype=float) for x in (change, day, session))
    if len(day) < MONITOR.least_logs:
        raise InputError(
            f"{len(day)} logs cannot tell wear from warming up: at least "
            f"{MONITOR.least_logs} are needed, of several days, some early and some "
            "late in their session."
        )
    # All time constants that explain the logs about as well as the best, the first.
    left = np.array([_left(change, day, np.exp(-session / time)) for time in TIMES])
    order = np.argsort(left, kind="stable")
    alike = order[left[order] <= left[order[0]] + MONITOR.as_well]
    times = TIMES[alike].tolist()
    warmths = [np.exp(-session / time) for time in times]
    alpha = MONITOR.alpha / (2 * change.shape[1])
    joints = [
        _joint(j, values, day, warmths, alpha) for j, values in enumerate(change.T)
    ]
    return joints, times[0]


def _left(change: Array, day: Array, warmth: Array) -> float:
    total = 0.0
    for values in change.T:
        known = np.isfinite(values)
        if known.sum() >= MONITOR.least_logs:
            columns = _columns(day[known], warmth[known], True, True)
            _, rest = _fit(values[known], columns)
            total += known.sum() * np.log(rest @ rest + 1e-12)
    return total


def _fit(values: Array, columns: Array) -> tuple[Array, Array]:
    theta = np.linalg.lstsq(columns, values)[0]
    return theta, values - columns @ theta


def _columns(day: Array, warmth: Array, wear: bool, warming: bool) -> Array:
    parts = [np.ones_like(day)]
    if wear:
        parts.append((day - day.mean()) / 30.0)
    if warming:
        parts.append(warmth - warmth.mean())
    return np.column_stack(parts)


def _joint(
    j: int, values: Array, day: Array, warmths: Sequence[Array], alpha: float
) -> JointTrend:
    known = np.isfinite(values)
    count = int(known.sum())
    if count < MONITOR.least_logs:
        why = f"only {count} logs move it, {MONITOR.least_logs} are needed"
        return JointTrend(j + 1, count, None, None, why)
    values, day = values[known], day[known]
    warmths = [warmth[known] for warmth in warmths]
    days = np.ptp(day) >= MONITOR.least_days
    warms = all(np.ptp(warmth) > MONITOR.warmer for warmth in warmths)
    related = [abs(np.corrcoef(day, warmth)[0, 1]) for warmth in warmths if warms]
    if days and any(one > MONITOR.alike for one in related):
        why = "later days were also measured at another warmth: not to be told apart"
        return JointTrend(j + 1, count, None, None, why)
    each = [_rates(values, _columns(day, w, days, warms), alpha) for w in warmths]
    # What holds with every time constant that explains the logs as well.
    rates = [
        replace(
            alike[0],
            low=min(rate.low for rate in alike),
            high=max(rate.high for rate in alike),
            real=all(rate.real for rate in alike),
        )
        for alike in zip(*each, strict=True)
    ]
    wear = rates.pop(0) if days else None
    warming = None
    if warms:
        cold = rates.pop(0)  # exp(-s / T) falls as the arm gets warm
        warming = Rate(-cold.value, -cold.high, -cold.low, cold.real)
    lacks = [] if days else ["all logs are of one day"]
    lacks += [] if warms else ["all logs are at the same warmth"]
    return JointTrend(j + 1, count, wear, warming, ", ".join(lacks))


def _rates(values: Array, columns: Array, alpha: float) -> list[Rate]:
    """Each coefficient but the constant, with its interval."""
    theta, rest = _fit(values, columns)
    free = len(values) - columns.shape[1]
    variance = max(rest @ rest / free, 1e-12)
    sd = np.sqrt(np.diag(variance * np.linalg.inv(columns.T @ columns)))
    wide, sure = student.ppf(0.975, free), student.ppf(1 - alpha / 2, free)
    real = np.abs(theta) > np.maximum(sure * sd, MONITOR.small)
    each = (x.tolist() for x in (theta, theta - wide * sd, theta + wide * sd, real))
    return list(map(Rate, *each))[1:]


def sessions(begins: Sequence[float], ends: Sequence[float], pause: float) -> Array:
    """Return when the session of each log began [s]: behind a pause of so long [s].

    Args:
        begins, ends: Time of the first and last sample of each log, by one clock [s].
    """
    order = np.argsort(begins)
    out, first, last = np.empty(len(order)), None, -np.inf
    for i in order:
        if first is None or begins[i] - last > pause:
            first = begins[i]
        out[i], last = first, max(last, ends[i])
    return out


@dataclass(frozen=True, eq=False, slots=True)
class LogFriction:
    """Friction of one log, relative to the model's."""

    id: str  # label of the recording
    # Relative change of each joint's friction torque; NaN where the joint did not move
    # or has no friction in the model, (dof,).
    change: Array
    sd: Array  # standard deviation of the change by the noise of the log, (dof,)


def friction_of_each(
    robot: Robot,
    recordings: Sequence[Recording],
    model: Model,
    told: Callable[[int], None] = lambda _: None,
) -> list[LogFriction]:
    """Return what each log says of the friction of each joint.

    Everything but friction is held to the model: what else is wrong with it shows as
    scatter between the logs, by which a trend is judged.

    Args:
        told: Called with the number of logs done.

    Raises:
        InputError: If the model has no friction, or the logs are not usable.
    """
    if not any(t.effect.brakes and len(t.joints) == 1 for t in model.terms):
        raise InputError(
            f"The model of {robot.name} has no friction, so none can be followed. "
            "Declare some in robot.toml, or give --model ID of one that has it."
        )
    out = []
    for i, one in enumerate(recordings):
        told(i)
        out.append(_of_one(robot, one, model))
    return out


def _of_one(robot: Robot, recording: Recording, model: Model) -> LogFriction:
    logs = prepare_logs(robot, [recording], None, Filters())
    now = replace(model, speed_floor=logs.speed_floor)
    seen = [_seen(now, track) for track in logs.tracks]
    change, sd = np.full((2, robot.dof), np.nan)
    for j in range(robot.dof):
        friction, left = (np.concatenate(x)[:, j] for x in zip(*seen, strict=True))
        power = float(friction @ friction)
        if power > 0:
            change[j] = friction @ left / power
            left = left - change[j] * friction
            rows = sum(int(t.moving[:, j].sum()) for t in logs.tracks)
            slow = max(autocorrelation_time(left), 1.0)
            sd[j] = np.sqrt(slow * (left @ left) / rows / power)
    return LogFriction(recording.id, change, sd)


def _seen(model: Model, track: Track) -> tuple[Array, Array]:
    """Friction torque of the model on the rows of a log, and what it leaves [N m].

    Both 0 where a joint does not move, and on more rows than noise remembers behind the
    log. Shapes (rows + LAGS, dof).
    """
    state = model.observe(track)
    friction = np.zeros_like(track.q)
    for term in (*model.terms, *model.tables):
        if term.effect.brakes:
            term.add_to(friction, state)
    left = track.tau - track.filter(model.torque_seen(state))
    behind = np.zeros((LAGS, track.tau.shape[1]))
    parts = (track.filter(friction) * track.moving, left * track.moving)
    friction, left = (np.concatenate([part, behind]) for part in parts)
    return friction, left
