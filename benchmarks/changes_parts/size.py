"""How large a change is: RMS of its torque over RMS of the joint's torque.

Both are low-pass filtered, on rows of the second epoch where the joint moves. What a
change does to angles counts by the torque of the rigid body at the angles read:

    effect = (tau - RNEA(q)) with it  -  (tau - RNEA(q)) without it

Nothing here knows of any method, and sensors add nothing.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.signal import butter, sosfiltfilt

from residual.recording import Recording
from residual.robot.dynamics import inverse_dynamics

Array = np.ndarray
# From motion to the torque of the rigid body. Shapes (n, dof).
RigidBody = Callable[[Array, Array, Array], Array]

CUTOFF = 8.0  # Hz
_ORDER = 4
_EDGE = 0.6  # s at each end of a log, where the filter is not itself
_SLOW = 0.03  # of the speed that 95 % of a log's samples stay below
_ROWS = 50.0  # Hz, of what is compared
_SEEN = 0.05  # of the rows: a joint that moves on fewer has no torque to compare with
_CLOSE, _TRIES = 0.01, 6  # of the size asked for; simulations
_STEEP = (0.3, 3.0)  # by what power a size may follow the parameter


class Smooth(NamedTuple):
    """A log on even times, filtered.

    Attributes:
        t: Times [s]. Shape (n,).
        q: Angles [rad], as all others of shape (n, dof).
        qd: Speeds [rad/s].
        qdd: Accelerations [rad/s^2].
        tau: Torque [N m].
    """

    t: Array
    q: Array
    qd: Array
    qdd: Array
    tau: Array


class Shares(NamedTuple):
    """What a change does in one log, on some rows. Shapes (n, dof).

    Attributes:
        effect: Torque of the change [N m].
        torque: Torque without it [N m].
        moves: Whether the joint moves.
    """

    effect: Array
    torque: Array
    moves: Array


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


def rigid_body(model: pin.Model) -> RigidBody:
    """Return the torque of a known rigid body."""
    return lambda q, qd, qdd: inverse_dynamics(model, q, qd, qdd)


def shares(rigid: RigidBody, with_: Recording, without: Recording) -> Shares:
    """Return what a change does in one log.

    Args:
        rigid: Torque of the arm's rigid body without the change.
        without: The same motion without it.
    """
    one, other = smooth(with_), smooth(without)
    every = max(1, round(1 / (_ROWS * (other.t[1] - other.t[0]))))
    rows = slice(None, min(len(one.t), len(other.t)), every)
    rest = [
        log.tau[rows] - rigid(log.q[rows], log.qd[rows], log.qdd[rows])
        for log in (one, other)
    ]
    return Shares(rest[0] - rest[1], other.tau[rows], moving(other)[rows])


def size_of(found: Sequence[Shares], joints: Sequence[int]) -> float:
    """Return the size of a change.

    Args:
        joints: Joints from 1 that have it; several or none: where it is largest.
    """
    effect, torque, moves = (np.concatenate(each) for each in zip(*found, strict=True))
    dof = torque.shape[1]
    places = [j - 1 for j in joints] if len(joints) == 1 else range(dof)
    sizes = [
        _rms(effect[moves[:, j], j]) / _rms(torque[moves[:, j], j])
        for j in places
        if moves[:, j].mean() > _SEEN
    ]
    return max(sizes, default=0.0)


def solved(
    size_at: Callable[[float], float | None], target: float
) -> tuple[float, float] | None:
    """Return by what to multiply a change for it to have a size, and that size.

    Args:
        size_at: Size for a multiple; None where no arm can be so.

    Returns:
        None where no arm can have it so large, or nothing shows of it at all.
    """
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
