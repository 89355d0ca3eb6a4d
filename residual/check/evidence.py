"""The evidence of one arm in the torques of all joints, on one Gram matrix.

Before a log is trusted, its torque may consist of the bodies of the robot file within a
rough prior, a load on the flange, friction, a tilted base, a force at the tool, and one
broad column for each other cause. All of these are linear in the unknowns:

    tau_j ~ N(Y_j pi_0, sigma_j^2 1 + A_j S A_j^T)

The Gram matrix of the columns A serves every order, sign and factor of the torques, and
every size of the priors S, and so every cause that explains a log as well as a fault.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from threading import Lock

import numpy as np
from cachetools import LRUCache, cached
from scipy.linalg import cho_factor, cho_solve, cholesky
from scipy.special import log_ndtr

from residual.check.thresholds import CHECK
from residual.evidence.priors import compute_inertial_precision
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
_APART = 0.3  # s: rows closer together count as one in the evidence
# Possible parts of a torque before a log is trusted: priors, one deviation each.
_BODY = 0.3  # relative, of the inertial parameters
_TILT = 0.1  # rad
_LOAD, _STRANGE, _LEVER = 0.05, 0.005, 0.15  # of the arm's mass; of its reach
_PULL = 0.05  # of the arm's weight, at the flange
_LEAST_SIZE = 0.05  # of the strongest joint's torque
_OUTER = 5  # columns of the world around the arm: two tilts, a force in three axes
_LOCAL = 10  # columns of one joint alone
_FRICTION, _WEIGHT = (1, 2, 7, 8), 9  # of these
_SHARE = 0.1  # largest missing share of a joint's weight
_ROUNDS = 2
# Times the prior of the bodies, which is 30 %: as given, a rough file, hardly a file.
GIVEN, ROUGH, LOOSE = 0.2, 1.0, 10.0
_STRONG = 6.0  # times the prior of the columns of one joint
_NOTHING = 1e-300
_PLAIN = [0, *_FRICTION[:2], 3]  # rotor, friction and offset of a joint


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
    moving: Array  # joint moves beyond its noise. Shape (n, dof), bool
    log: Array  # number of the recording of each row, (n,), int
    spread: float  # independent rows per row

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

    def _list_rows(self) -> dict[str, Array]:
        return {f.name: getattr(self, f.name) for f in fields(self)[:-1]}

    def sketch(self) -> "CheckMotion":
        """Return the motion thinned to independent rows."""
        every = max(1, int(1 / self.spread))
        parts = {name: rows[::every] for name, rows in self._list_rows().items()}
        return CheckMotion(**parts, spread=min(1.0, every * self.spread))

    def join(self, other: "CheckMotion | None") -> "CheckMotion":
        """Return the rows of both, with their mean spacing."""
        if other is None:
            return self
        more = other._list_rows()
        pairs = {k: np.concatenate([x, more[k]]) for k, x in self._list_rows().items()}
        rows = len(self.q) * self.spread + len(other.q) * other.spread
        return CheckMotion(**pairs, spread=rows / len(pairs["q"]))


def filter_check_motion(recordings: Sequence[Recording]) -> CheckMotion | None:
    """Filter and thin logs; None if nothing remains."""
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
    """The columns of one joint, each scaled by its prior, on its moving rows."""

    nominal: Array  # torque of the robot file [N m], (n,)
    values: Array  # torque per unit coefficient [N m], (n, p)
    brake: Array  # friction power per unit coefficient [W], (p,)
    weight: Array  # torque of gravity on the bodies of the file [N m], (n,)


def compute_gravity_axes(robot: Robot) -> tuple[Array, Array]:
    """Return gravity, and vectors of its size along the other two axes. (3,), (2, 3)."""
    down = np.asarray(robot.model.gravity.linear)
    across = np.delete(np.eye(3), np.argmax(np.abs(down)), axis=0)
    return down, float(np.linalg.norm(down)) * across


def build_prior_columns(robot: Robot, motion: CheckMotion) -> list[PriorColumns]:
    """Return the columns of every joint: local, of the surroundings, of the bodies."""
    y = compute_robot_regressor(robot, motion.q, motion.qd, motion.qdd)
    nominal = y @ read_inertial_parameters(robot.model)
    size = compute_row_rms(nominal)
    size = np.maximum(size, _LEAST_SIZE * max(size.max(), 1e-9))
    down, across = compute_gravity_axes(robot)
    fields, pulls = _compute_outer_torques(robot, motion.q)
    weight = fields @ down
    force = _PULL * _mass(robot) * max(float(np.linalg.norm(down)), 1.0)
    outer = np.concatenate([_TILT * fields @ across.T, force * pulls], axis=2)
    root, out = get_inertial_root(robot), []
    for j in range(motion.dof):
        use, first = motion.moving[:, j], PER_LINK * j
        local = np.column_stack([size[j] * _local(motion, j, use), _SHARE * weight[use, j]])
        bodies = np.zeros((int(use.sum()), PER_LINK * motion.dof))
        bodies[:, first:] = y[use, j, first:] @ root[first:, first:]
        values = np.column_stack([local, outer[use, j], bodies])
        brake = np.zeros(values.shape[1])
        friction = local[:, _FRICTION] * motion.qd[use, j, None]
        brake[list(_FRICTION)] = friction.sum(axis=0) / max(use.sum(), 1)
        out.append(PriorColumns(nominal[use, j], values, brake, weight[use, j]))
    return out


def compute_residual(robot: Robot, motion: CheckMotion, at: Array) -> Array:
    """Return the residual of the coefficients of all joints [N m]. (n, dof).

    NaN where a joint stands still.
    """
    out = np.full(motion.tau.shape, np.nan)
    common = at[_LOCAL * motion.dof :]
    for j, own in enumerate(build_prior_columns(robot, motion)):
        alone = at[_LOCAL * j : _LOCAL * (j + 1)]
        model, use = own.nominal + own.values @ np.concatenate([alone, common]), motion.moving[:, j]
        out[use, j] = motion.tau[use, j] - model
    return out


@lru_cache(maxsize=4)
def get_inertial_root(robot: Robot) -> Array:
    """Return the uncertainty of a rough robot file, and of an undescribed load.

    The lower root of the covariance of its parameters; motions and readings share it.
    """
    out = _BODY**2 * np.linalg.inv(compute_inertial_precision(robot, _BODY))
    way = compute_last_joint_distance(robot.model) or compute_reach(robot.model)
    lever = _LEVER * way
    sizes = _mass(robot) * np.array([1.0] + 3 * [lever] + 6 * [lever**2])
    out += np.diag(np.tile((_STRANGE * sizes) ** 2, robot.dof))
    out[-PER_LINK:, -PER_LINK:] += np.diag((_LOAD * sizes) ** 2)
    return cholesky(out, lower=True)


def _mass(robot: Robot) -> float:
    return sum(body.mass for body in list(robot.model.inertias)[1:])


@cached(LRUCache(64), key=build_motion_key, lock=Lock())
def _compute_outer_torques(robot: Robot, q: Array) -> tuple[Array, Array]:
    """Return torques against fields of 1 m/s^2, and 1 N on the flange. (n, dof, 3)."""
    pulls = compute_flange_jacobian(robot.model, q)[:, :3].transpose(0, 2, 1)
    return compute_weight_torques(robot.model, q), pulls


def _local(motion: CheckMotion, j: int, use: Array) -> Array:
    """Return columns of rotor, friction in several forms, and the angle. Shape (n, 9)."""
    q, qd, qdd = (x[use, j] for x in (motion.q, motion.qd, motion.qdd))
    turn = q - q.mean() if len(q) else q
    speed, hard, wide = (
        max(float(compute_row_rms(x)), 1e-6) if len(x) else 1.0 for x in (qd, qdd, turn)
    )
    forms = (qdd / hard, qd / speed, np.tanh(qd / (0.05 * speed)), np.ones_like(q))
    forms += (0.15 * np.sin(q), 0.15 * np.cos(q), 0.15 * turn / wide)
    forms += (0.5 * np.abs(qd) / speed, 0.5 * np.abs(qd) * qd / speed**2)
    return np.column_stack(forms)


@dataclass(frozen=True, eq=False, slots=True)
class Torques:
    """Channel (from 0) of the torque of each joint, and its factor."""

    order: Array  # (dof,), int
    factor: Array  # (dof,)


@dataclass(frozen=True, eq=False)
class ArmSums:
    """Sums of a motion over the coefficients of all joints; channels are columns."""

    gram: Array  # (dof, p, p)
    model: Array  # columns times the torque of the file, (dof, p)
    channel: Array  # columns times each torque channel, (dof, p, dof)
    power: Array  # squares of each channel, (dof, dof)
    cross: Array  # each channel times the torque of the file, (dof, dof)
    model_power: Array  # (dof,)
    rows: Array  # independent rows, (dof,)
    brake: Array  # friction power, by coefficient, (dof, p)
    root: Array  # of the covariance of the bodies, (10 dof, 10 dof)
    bodies: Array  # parameters of the file, (10 dof,)
    gravity: Array  # (3,)
    across: Array  # gravity of the same size along the other axes, (2, 3)

    @property
    def dof(self) -> int:
        """Number of joints."""
        return len(self.rows)

    @cached_property
    def load(self) -> Array:
        """Size of the torque of the file [N m]. Shape (dof,)."""
        return np.sqrt(self.model_power / np.maximum(self.rows, 1e-9))

    def local(self, j: int) -> slice:
        """Columns of joint j (from 0) only."""
        return slice(_LOCAL * j, _LOCAL * (j + 1))

    @property
    def outer(self) -> slice:
        """Two tilts of the base and three forces at the tool."""
        return slice(_LOCAL * self.dof, _LOCAL * self.dof + _OUTER)

    def link(self, j: int) -> slice:
        """Parameters of the body behind joint j (from 0)."""
        first = _LOCAL * self.dof + _OUTER + PER_LINK * j
        return slice(first, first + PER_LINK)

    def deviations(self, scale: float) -> Array:
        """Prior deviation of each coefficient for a given error of the bodies. (p,)."""
        out = np.ones(self.gram.shape[1])
        out[self.outer][:2] = 0.3  # a larger tilt is another mounting
        out[self.outer.stop :] = scale
        out[self.link(self.dof - 1)] = max(scale, 3.0)  # a load
        return out


def sum_arm(robot: Robot, motion: CheckMotion, weightless: bool = False) -> ArmSums:
    """Sum up a motion; ``weightless``: the driver removed the arm's weight."""
    dof = robot.dof
    size = _LOCAL * dof + _OUTER + PER_LINK * dof
    sums = np.zeros((dof, size + 1 + dof, size + 1 + dof))  # the file's torque, channels last
    brake, rows = np.zeros((dof, size)), np.zeros(dof)
    for j, own in enumerate(build_prior_columns(robot, motion)):
        common = np.arange(_LOCAL * dof, sums.shape[1])
        use = np.concatenate([_LOCAL * j + np.arange(_LOCAL), common])
        nominal = own.nominal - own.weight if weightless else own.nominal
        columns = np.column_stack([own.values, nominal, motion.tau[motion.moving[:, j]]])
        sums[j][np.ix_(use, use)] = motion.spread * columns.T @ columns
        brake[j, use[: own.brake.size]] = own.brake
        rows[j] = motion.spread * len(columns)
    return ArmSums(
        np.ascontiguousarray(sums[:, :size, :size]),
        sums[:, :size, size],
        sums[:, :size, size + 1 :],
        np.einsum("jaa->ja", sums)[:, size + 1 :],
        sums[:, size, size + 1 :],
        sums[:, size, size],
        rows,
        brake,
        get_inertial_root(robot),
        read_inertial_parameters(robot.model),
        *compute_gravity_axes(robot),
    )


@dataclass(frozen=True, eq=False, slots=True)
class ArmFit:
    """One arm fitted to the torques."""

    nats: float  # log evidence of the torques as logged
    at: Array  # coefficients, in deviations of the unit priors, (p,)
    sigma: Array  # residual of each torque [N m], (dof,)
    size: Array  # rms of each torque [N m], (dof,)
    braking: Array  # friction power, in its standard deviations, (dof,)


def fit_arm(sums: ArmSums, torques: Torques, deviations: Array) -> ArmFit:
    """Fit one arm to all torques, alternating with their noise."""
    joints = np.arange(sums.dof)
    f, order = torques.factor, torques.order
    power = f**2 * sums.power[joints, order]
    logged = np.sqrt(sums.power[joints, order] / np.maximum(sums.rows, 1e-9))
    size = np.abs(f) * logged
    square = power - 2 * f * sums.cross[joints, order] + sums.model_power
    target = f[:, None] * sums.channel[joints, :, order] - sums.model
    # The noise is that of the logged channel: no factor makes it smaller.
    floor = np.maximum(CHECK.least_rest * logged, 0.001 * logged.max())
    floor = np.maximum(np.abs(f) * floor, 1e-12)
    sigma = 2 * floor
    for turn in range(_ROUNDS + 1):
        weight = sigma**-2.0
        # In deviations of the priors the matrix is at least the identity.
        gram = np.tensordot(weight, sums.gram, 1) * np.outer(deviations, deviations)
        gram[np.diag_indices_from(gram)] += 1.0
        try:
            factor = cho_factor(gram, overwrite_a=True)
        except (ValueError, np.linalg.LinAlgError):  # angles of any size
            none = np.zeros(sums.dof)
            return ArmFit(-np.inf, 0.0 * deviations, size, size, none)
        right = weight @ target
        at = deviations * cho_solve(factor, deviations * right, check_finite=False)
        if turn == _ROUNDS:
            break
        left = square - 2 * target @ at + (sums.gram @ at) @ at
        left = np.sqrt(np.maximum(left, 0.0) / np.maximum(sums.rows, 1e-9))
        sigma = np.maximum(left, floor)
    quad = weight @ square - right @ at
    logs = 2 * np.log(np.diag(factor[0])).sum()
    moving = sums.rows > 0
    nats = -0.5 * (quad + logs) - sums.rows @ np.log(sigma)
    nats += sums.rows @ np.log(np.abs(f))
    brake = sums.brake * deviations
    solved = cho_solve(factor, brake.T, check_finite=False)
    spread = np.sum(brake * solved.T, axis=1)
    braking = (sums.brake @ at) / np.sqrt(np.maximum(spread, _NOTHING))
    nats += float(np.sum((log_ndtr(braking) + np.log(2))[moving]))
    return ArmFit(float(nats), at, sigma, size, np.where(moving, braking, 0.0))


def measure_strain(sums: ArmSums, fit: ArmFit) -> Array:
    """Return the deviation from the robot file and the misfit of each torque.

    Half the square of the bodies' coefficients, shared by the joints that carry them,
    friction that gives power, and a residual larger than that of a rough model [nats].
    Shape (dof,).

    Args:
        fit: The fit under a rough file.
    """
    bend = np.array([0.5 * np.sum((fit.at[sums.link(j)] / ROUGH) ** 2) for j in range(sums.dof)])
    bend[-1] *= (ROUGH / 3.0) ** 2
    missed = np.log(fit.sigma / np.maximum(CHECK.rough_rest * fit.size, _NOTHING))
    brakes = -(log_ndtr(fit.braking) + np.log(2))
    return bend + sums.rows * np.maximum(missed, 0.0) + np.maximum(brakes, 0.0)


def find_tilted_gravity(sums: ArmSums, torques: Torques) -> Array:
    """Return gravity as tilted by the fit, within the tilt of a base. (3,)."""
    deviations = sums.deviations(GIVEN)
    deviations[sums.outer][:2] = 3.0
    fit = fit_arm(sums, torques, deviations)
    turned = sums.gravity + _TILT * fit.at[sums.outer][:2] @ sums.across
    size = max(float(np.linalg.norm(turned)), _NOTHING)
    return turned * float(np.linalg.norm(sums.gravity)) / size


@dataclass(frozen=True, eq=False, slots=True)
class NominalShares:
    """Shares of the file's torque in each torque, apart from friction and offset."""

    ratio: Array  # (dof,)
    ratio_sd: Array  # (dof,)
    # Share explained by the file after friction, 0 to 1, (dof,).
    explained: Array
    load: Array  # size of the file's torque [N m], (dof,)

    def loaded(self, least_share: float = 0.1) -> Array:
        """Which joints carry the arm: on others the share is unreliable. (dof,), bool."""
        return self.load > least_share * self.load.max()


def fit_nominal_shares(sums: ArmSums, order: Array) -> NominalShares:
    """Fit tau = share * nominal + friction + offset + rotor, joint by joint.

    With a rough file, a load or gear losses the shares stay near one on the joints that
    carry the arm; torque in another unit, or without a part, changes them.
    """
    joints, size = np.arange(sums.dof), len(_PLAIN) + 1
    use = _LOCAL * joints[:, None] + _PLAIN
    gram = np.zeros((sums.dof, size, size))
    gram[:, 1:, 1:] = sums.gram[joints[:, None, None], use[:, :, None], use[:, None]]
    gram[:, 0, 1:] = gram[:, 1:, 0] = sums.model[joints[:, None], use]
    gram[:, 0, 0] = sums.model_power
    right = np.zeros((sums.dof, size))
    right[:, 0] = sums.cross[joints, order]
    right[:, 1:] = sums.channel[joints[:, None], use, order[:, None]]
    known = (sums.rows >= size + 2) & (gram[:, 0, 0] > 0)
    scale = np.sqrt(np.diagonal(gram, axis1=1, axis2=2)) + 1e-150
    gram = gram / (scale[:, :, None] * scale[:, None]) + 1e-9 * np.eye(size)
    gram[~known], right = np.eye(size), right / scale
    inverse = np.linalg.inv(gram)
    at = np.einsum("jab,jb->ja", inverse, right)
    power = sums.power[joints, order]
    left = np.maximum(power - np.sum(at * right, axis=1), 0.0)
    # Share explained by the file alone: its coefficient over its own precision.
    beside = left + at[:, 0] ** 2 / inverse[:, 0, 0]
    spread = np.sqrt(inverse[:, 0, 0] * left / np.maximum(sums.rows - size, 1e-9))
    explained = 1 - left / np.maximum(beside, _NOTHING)
    return NominalShares(
        np.where(known, at[:, 0] / scale[:, 0], np.nan),
        np.where(known, spread / scale[:, 0], np.inf),
        np.where(known, explained, 0.0),
        sums.load,
    )


def list_other_causes(sums: ArmSums, scale: float) -> dict[str, Array]:
    """Return other causes that may explain a log, as deviations of the coefficients.

    The effects of the library are covered by columns of a joint, a tool or a base, flaws
    of the file by bodies of any size.
    """
    out = {}
    base = sums.deviations(scale)
    for j in range(sums.dof):
        out[f"an effect on joint {j + 1}"] = wide = base.copy()
        wide[sums.local(j)] *= _STRONG
        out[f"a wrong body of link {j + 1} in the robot file"] = wide = base.copy()
        wide[sums.link(j)] = 100.0
    out["a force at the tool"] = wide = base.copy()
    wide[sums.outer][2:] *= 2 * _STRONG
    out["placeholder inertias in the robot file"] = tensors = base.copy()
    out["an arm that is balanced by counterweights or springs"] = balanced = base.copy()
    for j in range(sums.dof):
        tensors[sums.link(j)][4:] = 100.0
        balanced[sums.local(j)][_WEIGHT] = 10.0
    return out


def is_possible(sums: ArmSums, fit: ArmFit) -> bool:
    """Whether no mass of a fit is clearly negative, and no weight reversed."""
    first = sums.outer.stop
    given = sums.bodies[::PER_LINK]
    masses = given + (sums.root @ fit.at[first:])[::PER_LINK]
    balance = _SHARE * fit.at[[sums.local(j).start + _WEIGHT for j in range(sums.dof)]]
    heavy = masses > -0.5 * given - 0.02 * given.sum()
    return bool(heavy.all() and (balance > -1.5).all())
