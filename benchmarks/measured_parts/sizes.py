"""Size of a change in a log.

A size is RMS of the change's torque over RMS of the joint's torque, both low-pass
filtered, on rows where the joint moves.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.signal import butter, sosfiltfilt

from residual.recording import Recording

Array = np.ndarray
CUTOFF = 8.0  # Hz
_ORDER = 4
_EDGE = 0.6  # s at each end of a log, where the filter is not itself
_SLOW = 0.03  # of the speed that 95 % of a log's samples stay below


class Smooth(NamedTuple):
    """A log on even times, filtered."""

    t: Array  # times [s]. Shape (n,).
    q: Array  # angles [rad], as all others of shape (n, dof)
    qd: Array  # speeds [rad/s]
    qdd: Array  # accelerations [rad/s^2]
    tau: Array  # torque [N m]


def smooth(log: Recording) -> Smooth:
    """Return a log on even times through a low pass without lag."""
    step = float(np.median(np.diff(log.t)))
    t = log.t[0] + step * np.arange(int((log.t[-1] - log.t[0]) / step) + 1)
    corner = min(0.9, 2 * CUTOFF * step)
    sos = butter(_ORDER, corner, output="sos")

    def filtered(values: Array) -> Array:
        even = np.column_stack([np.interp(t, log.t, column) for column in values.T])
        return sosfiltfilt(sos, even, axis=0)

    q = filtered(log.q)
    qd = np.gradient(q, step, axis=0)
    return Smooth(t, q, qd, np.gradient(qd, step, axis=0), filtered(log.tau))


def moving(log: Smooth) -> Array:
    """Return where each joint moves, the ends of the log apart. Shape (n, dof)."""
    speed = np.abs(log.qd)
    inside = (log.t > log.t[0] + _EDGE) & (log.t < log.t[-1] - _EDGE)
    return (speed > _SLOW * np.quantile(speed, 0.95, axis=0)) & inside[:, None]


def size_of(effects: Sequence[Array], logs: Sequence[Smooth], joint: int) -> float:
    """Return the size of a change on a joint, from its torque in each log, filtered."""
    moves = [moving(log)[:, joint - 1] for log in logs]
    change, torque = (
        np.concatenate([x[m, joint - 1] for x, m in zip(of, moves, strict=True)])
        for of in (effects, [log.tau for log in logs])
    )
    return _rms(change) / _rms(torque)


def _rms(values: Array) -> float:
    return float(np.sqrt((values**2).mean()))
