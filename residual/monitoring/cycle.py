"""Programs that repeat: how long a cycle is, and what was a cycle ago."""

import numpy as np

from residual.monitoring.track import Rows
from residual.recording import Array

SAME = 2e-3  # rad: how near to its own past a wanted position is in the next cycle
_SHORTEST = 0.5  # s
_SHARE = 0.5  # of the rows that move must repeat; others are alike at any lag
_MOVING = 0.1  # of the rows must move


def period_of(rows: Rows) -> float | None:
    """Return the length of a cycle of the wanted motion [s], None if none repeats.

    A program is known before it runs, so this looks at the whole log.
    """
    if rows.goal is None:
        return None
    goal, low = np.ascontiguousarray(rows.goal.T), round(_SHORTEST * rows.rate)
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
