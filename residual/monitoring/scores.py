"""The bank: every score that a monitor keeps, over the time of a log.

Scores have no unit and no common size; limits (``usual.limits_of``) give them one. Each
is stamped with the last sample that it knows.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.effects.base import State
from residual.model.model import Model, with_slots
from residual.monitoring.rows import LogRows, period_of, rows_of
from residual.monitoring.rules import MONITOR
from residual.recording import Array, Recording
from residual.robot.dynamics import torque_by_angle
from residual.signals import splitting as pieces

_TINY = 1e-9
AT_ONCE = 40_000  # rows: ten minutes


# What a monitor knows of a log: its rows, and the torque that a model expects there.
#
# tau = A(q, qd, qdd) theta, A the inertial regressor and the columns of the effects.
# Least squares with a pull to the coefficients that the model came with, in units of
# the torque that a coefficient makes: what the runs do not show stays as it was.


@dataclass(frozen=True, eq=False, slots=True)
class Sight:
    """What is known of a log before it is judged."""

    rows: LogRows  # motion and torque
    model: Model  # what expects the torque
    state: State  # what its effects see
    # Torque per unit of each coefficient of its effects, (m, dof, k).
    terms: tuple[Array, ...]
    # Change of the torques with the angle of a joint, the last axis [N m/rad],
    # (m, dof, dof).
    by_angle: Array
    slow: Array  # the joint stands or has just stood. Shape (m, dof), bool
    # Length of a cycle of the program [s], None where nothing repeats.
    period: float | None

    def torque(self, theta: Array) -> Array:
        """Torque with these coefficients [N m]. Shape (m, dof)."""
        size = len(self.model.inertial)
        out = self.state.regressor @ theta[:size]
        for (_, own), x in zip(
            with_slots(self.model.terms, size), self.terms, strict=True
        ):
            out = out + x @ theta[own]
        return out

    def columns(self) -> Iterator[tuple[slice, Array]]:
        """Torque per unit of each coefficient, some rows at a time. (rows, dof, p)."""
        for first in range(0, len(self.rows.t), AT_ONCE):
            rows = slice(first, first + AT_ONCE)
            parts = [self.state.regressor[rows], *(x[rows] for x in self.terms)]
            yield rows, np.concatenate(parts, axis=2)


def sight_of(model: Model, recording: Recording) -> Sight:
    """Return what a model makes of a log."""
    rows = rows_of(recording)
    state = model.observe(rows)
    slow = np.abs(rows.qd) < MONITOR.slow * model.speed_floor
    return Sight(
        rows=rows,
        model=model,
        state=state,
        terms=tuple(term.regressor(state) for term in model.terms),
        by_angle=torque_by_angle(model.robot.model, rows.q, rows.qd, rows.qdd),
        slow=_trailing(slow, round(MONITOR.memory * rows.rate)) > 0,
        period=period_of(rows),
    )


def fit(model: Model, logs: Sequence[Sight], without: int = -1) -> Array:
    """Fit the coefficients to logs, but for one of them; -1 for none. Shape (p,)."""
    theta = model.coefficients()
    square = [np.mean(log.rows.tau**2, axis=0) for log in logs]
    size = np.maximum(np.sqrt(np.mean(square, axis=0)), _TINY)
    gram, right = np.zeros((len(theta), len(theta))), np.zeros(len(theta))
    for log in (log for i, log in enumerate(logs) if i != without):
        use = (~log.slow & log.rows.inner[:, None]) / size
        left = (log.rows.tau - log.torque(theta)) * use
        for rows, columns in log.columns():
            weighed = (columns * use[rows][..., None]).reshape(-1, len(theta))
            gram += weighed.T @ weighed
            right += weighed.T @ left[rows].ravel()
    scale = np.sqrt(np.diag(gram))
    live = scale > _TINY * max(scale.max(), _TINY)
    inner = gram[np.ix_(live, live)] / np.outer(scale[live], scale[live])
    pull = MONITOR.pull * np.eye(int(live.sum()))
    step = np.linalg.solve(inner + pull, right[live] / scale[live])
    out = theta.copy()
    out[live] += step / scale[live]
    return out


@dataclass(frozen=True, slots=True)
class Channel:
    """Where a score points to."""

    joint: int  # joint from 1; 0 where the score is of all together
    sensor: str  # "encoder", "torque", or "" for all
    fault: str  # name of the fault that it looks for


@dataclass(frozen=True, eq=False, slots=True)
class Scores:
    """Scores of one kind."""

    kind: str  # jump, spikes, frozen, still, model, cycle or errors
    t: Array  # times [s], (m,)
    values: Array  # at least 0; larger is worse, (m, c)
    channels: tuple[Channel, ...]  # what each column points to


@dataclass(frozen=True, eq=False, slots=True)
class Scale:
    """What is usual of errors, learnt from good runs."""

    # Root mean square of the torque residual, moving and slow [N m], (2, dof).
    residual: Array
    change: Array  # the same of its difference from the cycle before, (2, dof)
    # Of the columns of the errors, (e,).
    mean: Array
    size: Array
    loadings: Array  # of the components kept, (e, a)
    variance: Array  # of the scores on them, (a,)


def fast_scores(recording: Recording) -> tuple[Scores, ...]:
    """Return the scores that look at raw samples: jump, spikes, frozen, still.

    Of more than ten minutes the largest of each 16 ms, with the time of its last
    sample; a reading is known to have rested for a minute or more.
    """
    if recording.duration <= pieces.LONG:
        return _fast_scores(recording)
    n = len(recording.t)
    minute = round(pieces.PIECE * (n - 1) / recording.duration)
    pool = max(1, round(MONITOR.step * minute / pieces.PIECE))
    starts = range(0, n, minute - minute % pool)
    parts = []
    for start in starts:
        # Scores of a minute know the minute before.
        stop = min(start + starts.step, n)
        part = pieces.rows_of(recording, max(0, 2 * start - stop), stop)
        parts.append(
            [_largest(s, recording.t[start], pool) for s in _fast_scores(part)]
        )
    return tuple(
        replace(
            own[0],
            t=np.concatenate([p.t for p in own]),
            values=np.concatenate([p.values for p in own]),
        )
        for own in zip(*parts, strict=True)
    )


def _largest(scores: Scores, start: float, pool: int) -> Scores:
    own = slice(int(np.searchsorted(scores.t, start)), None)
    t, values = scores.t[own], scores.values[own]
    first = np.arange(0, len(t), pool)
    last = np.append(first[1:], len(t)) - 1
    return replace(scores, t=t[last], values=np.maximum.reduceat(values, first, axis=0))


def _fast_scores(recording: Recording) -> tuple[Scores, ...]:
    t, q, tau = recording.t, recording.q, recording.tau
    error = q if recording.q_ref is None else q - recording.q_ref
    bend = np.abs(np.diff(error, 2, axis=0))
    wide = np.lib.stride_tricks.sliding_window_view(tau, 2 * MONITOR.spread + 1, axis=0)
    middle = tau[MONITOR.spread : -MONITOR.spread]
    spike = np.abs(middle - np.median(wide, axis=2))
    count, travel = _standing(q, recording.q_ref)
    whole = np.diff(t) < 1.5 * np.median(np.diff(t))  # nothing is told across gaps
    bend[~(whole[1:] & whole[:-1])] = 0.0
    each = (
        ("jump", bend, "encoder", "jump"),
        ("spikes", spike, "torque", "spikes"),
        ("frozen", travel, "encoder", "frozen"),
        ("still", count, "encoder", "frozen"),
    )
    return tuple(
        Scores(kind, t[len(t) - len(x) :], x, channels(recording.dof, *about))
        for kind, x, *about in each
    )


def channels(dof: int, sensor: str, fault: str) -> tuple[Channel, ...]:
    """Return one channel for each joint."""
    return tuple(Channel(j, sensor, fault) for j in range(1, dof + 1))


def matched_scores(
    kind: str, rest: Array, tau: Array, log: Sight, size: Array, usable: Array
) -> Scores:
    """Return matched features in what is left of the torque.

    |sum w f r| / sqrt(sum w f^2) over the last 0.25 and 1 s, w = 1 / size^2, for
    f = 1 (bias), the expected torque (gain) and its change by an angle (encoder); of
    the gain only a drop counts

    Args:
        kind: "model", or "cycle" for the difference from the cycle before.
        tau: Torque that is expected [N m]. Shape (m, dof).
        size: What is usual of what is left, moving and slow [N m]. Shape (2, dof).
    """
    weight = usable[:, None] / np.where(log.slow, size[1], size[0]) ** 2
    turn, dof = log.by_angle, rest.shape[1]
    named: list[Channel] = []
    values = []
    for window in MONITOR.windows:
        count = max(2, round(window * log.rows.rate))
        for fault, f in (("torque bias", np.ones(rest.shape)), ("gain drop", tau)):
            drop = fault == "gain drop"
            over = weight * f * (-rest if drop else rest)
            values.append(_matched(over, weight * f * f, count, one_side=drop))
            named += channels(dof, "torque", fault)
        over = np.einsum("mi,mij->mj", weight * rest, turn)
        under = np.einsum("mi,mij->mj", weight, turn**2)
        values.append(_matched(over, under, count))
        named += channels(dof, "encoder", "bias")
    return Scores(kind, log.rows.t, np.hstack(values), tuple(named))


def error_block(residual: Array, rows: LogRows) -> Array:
    """Return the errors that T2 and SPE look at: e_q, e_qd, torque. Shape (m, e)."""
    if rows.e_q is None:
        return residual
    return np.column_stack([rows.e_q, rows.e_qd, residual])


def error_scores(errors: Array, rows: LogRows, scale: Scale) -> Scores:
    """Return T2 and SPE of the principal components of the errors.

    T2 = sum t_a^2 / lambda_a, t = P'z; SPE = |z - P t|^2     (Jackson & Mudholkar 1979)

    Their roots are returned, whose tails decay like those of the other scores.
    """
    z = (errors - scale.mean) / scale.size
    t = z @ scale.loadings
    both = np.column_stack(
        [(t**2 / scale.variance).sum(axis=1), ((z - t @ scale.loadings.T) ** 2).sum(1)]
    )
    both[~rows.inner] = 0.0
    named = tuple(Channel(0, "", f"deviation ({name})") for name in ("T2", "SPE"))
    return Scores("errors", rows.t, np.sqrt(both), named)


def blamed(errors: Array, scale: Scale, dof: int) -> tuple[int, str]:
    """Return joint and sensor of the error that is largest on a row. Shape (e,)."""
    worst = int(np.argmax(np.abs((errors - scale.mean) / scale.size)))
    torque = len(errors) - dof
    return worst % dof + 1, "torque" if worst >= torque else "encoder"


def _standing(q: Array, goal: Array | None) -> tuple[Array, Array]:
    """Return how long each reading has not changed, in samples, and what was wanted.

    Returns:
        Samples equal to the one before, in a row; and how far the wanted position has
        come meanwhile [rad]; zeros where it is not logged. Shapes (n, dof).
    """
    row = np.arange(len(q))[:, None]
    new = np.vstack([np.ones((1, q.shape[1]), bool), np.diff(q, axis=0) != 0])
    since = np.maximum.accumulate(np.where(new, row, 0), axis=0)
    count = (row - since).astype(float)
    if goal is None:
        return count, np.zeros(q.shape)
    return count, np.abs(goal - np.take_along_axis(goal, since, axis=0))


def _matched(over: Array, under: Array, count: int, one_side: bool = False) -> Array:
    """Score of trailing windows; 0 where nothing was to be seen. Shape (m, c)."""
    over, under = _trailing(over, count), _trailing(under, count)
    seen = under > _TINY
    over = np.maximum(over, 0.0) if one_side else np.abs(over)
    return over / np.sqrt(np.where(seen, under, 1.0)) * seen


def _trailing(x: Array, count: int) -> Array:
    """Sum over the last rows, fewer at the beginning. Shape (m, c)."""
    total = np.cumsum(x, axis=0)
    return total - np.vstack([np.zeros((count, x.shape[1])), total])[: len(x)]
