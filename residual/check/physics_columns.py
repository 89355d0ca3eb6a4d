"""Rows for the physics of a log, and the columns that may explain its torque.

Before a log is believed these are the bodies of the robot file within a rough prior, a
load on the flange, and one broad column for each other cause of torque. A fault must
explain more than all of these can.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from threading import Lock

import numpy as np
from cachetools import LRUCache, cached
from scipy.linalg import cholesky

from residual.evidence.priors import compute_inertial_precision
from residual.quantity import make_read_only
from residual.recording import Array, Recording
from residual.robot.dynamics import (
    PER_LINK,
    build_motion_key,
    compute_flange_jacobian,
    compute_last_joint_distance,
    compute_reach,
    compute_robot_regressor,
    compute_weight_torques,
    read_inertial_parameters,
)
from residual.robot.robot import Robot
from residual.signals.track import FilterSettings, build_tracks

_FILTERS = FilterSettings(5.0, 5.0, 60.0)  # Hz: on angles, on torque, of the rows
_MOST_ROWS = 360
_APART = 0.3  # s: rows nearer to each other count as one in evidence
# What a torque may be made of before a log is believed: priors, one deviation each.
BODY = 0.3  # relative, of the inertial parameters
TILT = 0.1  # rad
_LOAD, _STRANGE, _LEVER = 0.05, 0.005, 0.15  # of the arm's mass; of its reach
_PULL = 0.05  # of the arm's weight, at the flange
_LEAST_SIZE = 0.05  # of the strongest joint's torque
_NOTHING = 1e-9
OUTER = 5  # columns of the world around the arm: two tilts, a force in three axes
LOCAL = 10  # columns of one joint alone
FRICTION, WEIGHT = (1, 2, 7, 8), 9  # of these
SHARE = 0.1  # of the weight that a joint may miss


def compute_row_rms(x: Array) -> Array:
    """Return the root mean square along the rows."""
    return np.sqrt(np.mean(x**2, axis=0))


@dataclass(frozen=True, eq=False, slots=True)
class CheckMotion:
    """Filtered rows of all logs of one column map."""

    # Filtered kinematics [rad, rad/s, rad/s^2], (n, dof).
    q: Array
    qd: Array
    qdd: Array
    tau: Array  # torque behind the same filter [N m], (n, dof)
    moving: Array  # joint moves, beyond what its noise does. Shape (n, dof), bool
    log: Array  # which of the recordings a row is of, (n,), int
    spread: float  # independent rows for each row that is there

    @property
    def dof(self) -> int:
        """Number of joints."""
        return self.q.shape[1]

    def reorder_angles(self, order: Sequence[int], scale: Array) -> "CheckMotion":
        """Return the motion with other angles: channel ``order[j]``, times a factor.

        Channels from 0, and the factor on each joint's angle. Shape (dof,).
        """
        order = list(order)
        parts = {k: getattr(self, k)[:, order] * scale for k in ("q", "qd", "qdd")}
        return replace(self, moving=self.moving[:, order], **parts)

    def sketch(self) -> "CheckMotion":
        """Return the motion by rows that are independent of each other."""
        every = max(1, int(1 / self.spread))
        names = ("q", "qd", "qdd", "tau", "moving", "log")
        parts = {name: getattr(self, name)[::every] for name in names}
        return replace(self, **parts, spread=min(1.0, every * self.spread))

    def join(self, other: "CheckMotion | None") -> "CheckMotion":
        """Return the rows of both, of the larger spread."""
        if other is None:
            return self
        pairs = {
            name: np.concatenate([getattr(self, name), getattr(other, name)])
            for name in ("q", "qd", "qdd", "tau", "moving", "log")
        }
        rows = len(self.q) * self.spread + len(other.q) * other.spread
        return CheckMotion(**pairs, spread=rows / len(pairs["q"]))


def filter_check_motion(recordings: Sequence[Recording]) -> CheckMotion | None:
    """Filter and thin logs; None where nothing is left of them."""
    long = [r for r in recordings if len(r.t) > 20]
    tracks, _ = build_tracks(long, _FILTERS) if long else ((), None)
    total = sum(int(track.valid.sum()) for track in tracks)
    if total < 10:
        return None
    every, parts = max(1, int(np.ceil(total / _MOST_ROWS))), []
    for number, track in enumerate(tracks):
        use = np.flatnonzero(track.valid)[::every]
        motion = (x[:: track.step][use] for x in (track.q, track.qd, track.qdd))
        label = np.full(len(use), number)
        parts.append((*motion, track.tau[use], track.moving[use], label))
    rows = [np.concatenate(part) for part in zip(*parts, strict=True)]
    seconds = sum(t.valid.sum() * t.step / t.rate for t in tracks)
    return CheckMotion(*rows, spread=min(1.0, seconds / _APART / len(rows[0])))


@dataclass(frozen=True, eq=False, slots=True)
class PriorColumns:
    """The columns of one joint, each of the size of its prior, on its moving rows."""

    nominal: Array  # torque of the robot file [N m], (n,)
    values: Array  # torque of each coefficient of one [N m], (n, p)
    brake: Array  # power that friction takes, per coefficient of one [W], (p,)
    rows: Array  # rows that are used. Shape of all rows, bool
    weight: Array  # torque of gravity on the bodies of the file [N m], (n,)


# Many readings of a log, and directions of gravity, look at the same motion. A cache
# does not guard itself, and the steps of a night run in threads.
_TORQUES: LRUCache = LRUCache(128)
_LOCK = Lock()


def compute_nominal_torque(robot: Robot, motion: CheckMotion) -> Array:
    """Return the torque of the robot file [N m]. Shape (n, dof)."""
    key = build_motion_key(robot, motion.q, motion.qd, motion.qdd)
    with _LOCK:
        known = _TORQUES.get(key)
    return _inertial_columns(robot, motion)[1] if known is None else known


def _inertial_columns(robot: Robot, motion: CheckMotion) -> tuple[Array, Array]:
    """Return the inertial regressor, and the torque of the robot file. (n, dof)."""
    parts = motion.q, motion.qd, motion.qdd
    y = compute_robot_regressor(robot, *parts)
    torque = make_read_only(y @ read_inertial_parameters(robot.model))
    with _LOCK:
        _TORQUES[build_motion_key(robot, *parts)] = torque
    return y, torque


def compute_gravity_axes(robot: Robot) -> tuple[Array, Array]:
    """Return gravity, and as much of it along the other two axes. (3,), (2, 3)."""
    down = np.asarray(robot.model.gravity.linear)
    across = np.delete(np.eye(3), np.argmax(np.abs(down)), axis=0)
    return down, float(np.linalg.norm(down)) * across


def build_prior_columns(robot: Robot, motion: CheckMotion) -> list[PriorColumns]:
    """Return the columns of every joint: its own, those of the world, the bodies'."""
    y, nominal = _inertial_columns(robot, motion)
    size = compute_row_rms(nominal)
    size = np.maximum(size, _LEAST_SIZE * max(size.max(), _NOTHING))
    down, across = compute_gravity_axes(robot)
    fields = _weight_torques(robot, motion.q)
    weight = fields @ down
    force = _PULL * _mass(robot) * max(float(np.linalg.norm(down)), 1.0)
    pulls = force * _pull_torques(robot, motion.q)
    outer = np.concatenate([TILT * fields @ across.T, pulls], axis=2)
    root, out = get_inertial_root(robot), []
    for j in range(motion.dof):
        use, first = motion.moving[:, j], PER_LINK * j
        local = np.column_stack([size[j] * _local(motion, j, use), SHARE * weight[use, j]])
        bodies = np.zeros((int(use.sum()), PER_LINK * motion.dof))
        bodies[:, first:] = y[use, j, first:] @ root[first:, first:]
        values = np.column_stack([local, outer[use, j], bodies])
        brake = np.zeros(values.shape[1])
        if use.any():
            friction = local[:, FRICTION] * motion.qd[use, j, None]
            brake[list(FRICTION)] = friction.mean(axis=0)
        own = nominal[use, j], values, brake, use, weight[use, j]
        out.append(PriorColumns(*own))
    return out


def compute_residual(robot: Robot, motion: CheckMotion, at: Array) -> Array:
    """Return what coefficients of all joints leave of the torques [N m]. (n, dof).

    Not a number where a joint stands.
    """
    out = np.full(motion.tau.shape, np.nan)
    common = at[LOCAL * motion.dof :]
    for j, own in enumerate(build_prior_columns(robot, motion)):
        alone = at[LOCAL * j : LOCAL * (j + 1)]
        model = own.nominal + own.values @ np.concatenate([alone, common])
        out[own.rows, j] = motion.tau[own.rows, j] - model
    return out


@lru_cache(maxsize=4)
def get_inertial_root(robot: Robot) -> Array:
    """What a rough robot file leaves open, and a load that it may not have at all.

    The lower root of the covariance of its parameters; motions and readings share it.
    """
    out = BODY**2 * np.linalg.inv(compute_inertial_precision(robot, BODY))
    way = compute_last_joint_distance(robot.model) or compute_reach(robot.model)
    lever = _LEVER * way
    sizes = _mass(robot) * np.array([1.0] + 3 * [lever] + 6 * [lever**2])
    out += np.diag(np.tile((_STRANGE * sizes) ** 2, robot.dof))
    out[-PER_LINK:, -PER_LINK:] += np.diag((_LOAD * sizes) ** 2)
    return cholesky(out, lower=True)


def _mass(robot: Robot) -> float:
    return sum(body.mass for body in list(robot.model.inertias)[1:])


@cached(LRUCache(64), key=build_motion_key, lock=Lock())
def _weight_torques(robot: Robot, q: Array) -> Array:
    """Torques that hold the arm in fields of 1 m/s^2. Shape (n, dof, 3)."""
    return compute_weight_torques(robot.model, q)


@cached(LRUCache(64), key=build_motion_key, lock=Lock())
def _pull_torques(robot: Robot, q: Array) -> Array:
    """Torques of a force of 1 N on the flange along each axis. Shape (n, dof, 3)."""
    return compute_flange_jacobian(robot.model, q)[:, :3].transpose(0, 2, 1)


def _local(motion: CheckMotion, j: int, use: Array) -> Array:
    """Rotor, friction in several forms, and what follows the angle. Shape (n, 9)."""
    q, qd, qdd = (x[use, j] for x in (motion.q, motion.qd, motion.qdd))
    turn = q - q.mean() if len(q) else q
    speed, hard, wide = (
        max(float(compute_row_rms(x)), 1e-6) if len(x) else 1.0 for x in (qd, qdd, turn)
    )
    return np.column_stack(
        [
            qdd / hard,
            qd / speed,
            np.tanh(qd / (0.05 * speed)),
            np.ones_like(q),
            0.15 * np.sin(q),
            0.15 * np.cos(q),
            0.15 * turn / wide,
            0.5 * np.abs(qd) / speed,
            0.5 * np.abs(qd) * qd / speed**2,
        ]
    )
