"""Size of a change in a log.

A size is RMS of the change's torque over RMS of the joint's torque, both low-pass
filtered, on rows where the joint moves.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.signal import butter, sosfiltfilt

from residual.recording import Recording

Array = np.ndarray
CUTOFF = 8.0  # Hz
_ORDER = 4
_EDGE = 0.6  # s at each end of a log, where the filter is not itself
_SLOW = 0.03  # of the speed that 95 % of a log's samples stay below
_SEEN = 0.05  # of the rows: a joint that moves on fewer has no torque to compare with
_CLOSE, _TRIES = 0.01, 6  # of the size asked for; simulations
_STEEP = (0.3, 3.0)  # by what power a size may follow the parameter


class Smooth(NamedTuple):
    """A log on even times, filtered."""

    t: Array  # times [s]. Shape (n,).
    q: Array  # angles [rad], as all others of shape (n, dof)
    qd: Array  # speeds [rad/s]
    qdd: Array  # accelerations [rad/s^2]
    tau: Array  # torque [N m]


class Shares(NamedTuple):
    """What a change does in one log, on some rows. Shapes (n, dof)."""

    effect: Array  # torque of the change [N m]
    torque: Array  # torque without it [N m]
    moves: Array  # whether the joint moves


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


def size_of(found: Sequence[Shares], joints: Sequence[int]) -> float:
    """Return the size of a change; of several joints or none where it is largest."""
    effect, torque, moves = (np.concatenate(each) for each in zip(*found, strict=True))
    dof = torque.shape[1]
    places = [j - 1 for j in joints] if len(joints) == 1 else range(dof)
    sizes = [
        _rms(effect[moves[:, j], j]) / _rms(torque[moves[:, j], j])
        for j in places
        if moves[:, j].mean() > _SEEN
    ]
    return max(sizes, default=0.0)


def solved(size_at: Callable[[float], float | None], target: float) -> tuple[float, float] | None:
    """Return what times a change has a size, and that size; None for never."""
    before: tuple[float, float] | None = None
    factor = 1.0
    for _ in range(_TRIES):
        size = size_at(factor)
        if size is None or not 0 < size < np.inf:
            return None
        miss = float(np.log(target / size))
        if abs(miss) <= _CLOSE:
            return factor, size
        power = 1.0
        if before is not None and abs(step := np.log(factor) - before[0]) > 1e-9:
            power = float(np.clip((np.log(size) - before[1]) / step, *_STEEP))
        before = float(np.log(factor)), float(np.log(size))
        factor *= float(np.exp(miss / power))
    return None


def _rms(values: Array) -> float:
    return float(np.sqrt((values**2).mean()))
