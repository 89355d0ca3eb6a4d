"""The evidence of one arm in the torques of all joints, on one Gram matrix.

With the bodies of the robot file within a prior, a load, friction, a tilted base and a
force at the tool, torque is linear in all that is unknown:

    tau_j ~ N(Y_j pi_0, sigma_j^2 1 + A_j S A_j^T)

The sums of the columns A serve every order, sign and factor of the torques, every size
of the priors S, and so every cause that explains a log as well as a fault does.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.special import log_ndtr

from residual.check.physics_columns import (
    FRICTION,
    LOCAL,
    OUTER,
    SHARE,
    TILT,
    WEIGHT,
    CheckMotion,
    build_prior_columns,
    compute_gravity_axes,
    get_inertial_root,
)
from residual.check.thresholds import CHECK
from residual.recording import Array
from residual.robot.dynamics import PER_LINK, read_inertial_parameters
from residual.robot.robot import Robot

_ROUNDS = 2
# Times the prior of the bodies, which is 30 %: as given, a rough file, hardly a file.
GIVEN, ROUGH, LOOSE = 0.2, 1.0, 10.0
_STRONG = 6.0  # times the prior of what one joint may have
_NOTHING = 1e-300
_PLAIN = [0, *FRICTION[:2], 3]  # rotor, friction and offset of a joint


@dataclass(frozen=True, eq=False, slots=True)
class Torques:
    """Which channel (from 0) is the torque of each joint, and times what."""

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
    brake: Array  # power that friction takes, by coefficient, (dof, p)
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
        """Columns that joint j (from 0) alone has."""
        return slice(LOCAL * j, LOCAL * (j + 1))

    @property
    def outer(self) -> slice:
        """Two tilts of the base and three forces at the tool."""
        return slice(LOCAL * self.dof, LOCAL * self.dof + OUTER)

    def link(self, j: int) -> slice:
        """Parameters of the body behind joint j (from 0)."""
        first = LOCAL * self.dof + OUTER + PER_LINK * j
        return slice(first, first + PER_LINK)

    def deviations(self, scale: float) -> Array:
        """Deviation of each coefficient where bodies are off by that much. (p,)."""
        out = np.ones(self.gram.shape[1])
        out[self.outer][:2] = 0.3  # more of a tilt is another mounting
        out[self.outer.stop :] = scale
        out[self.link(self.dof - 1)] = max(scale, 3.0)  # a load
        return out


def sum_arm(robot: Robot, motion: CheckMotion, weightless: bool = False) -> ArmSums:
    """Sum up a motion; ``weightless``: the driver took the arm's weight out."""
    dof = robot.dof
    size = LOCAL * dof + OUTER + PER_LINK * dof
    gram, model = np.zeros((dof, size, size)), np.zeros((dof, size))
    channel, brake = np.zeros((dof, size, dof)), np.zeros((dof, size))
    power, cross, model_power, rows = (
        np.zeros((dof, dof)),
        np.zeros((dof, dof)),
        np.zeros(dof),
        np.zeros(dof),
    )
    local, common = np.arange(LOCAL), np.arange(LOCAL * dof, size)
    for j, own in enumerate(build_prior_columns(robot, motion)):
        use = np.concatenate([LOCAL * j + local, common])
        tau, weight, nominal = motion.tau[own.rows], motion.spread, own.nominal
        if weightless:
            nominal = nominal - own.weight
        gram[j][np.ix_(use, use)] = weight * own.values.T @ own.values
        model[j, use] = weight * own.values.T @ nominal
        channel[j, use] = weight * own.values.T @ tau
        brake[j, use] = own.brake
        power[j] = weight * np.sum(tau**2, axis=0)
        cross[j] = weight * nominal @ tau
        model_power[j] = weight * nominal @ nominal
        rows[j] = weight * len(tau)
    down, across = compute_gravity_axes(robot)
    return ArmSums(
        gram,
        model,
        channel,
        power,
        cross,
        model_power,
        rows,
        brake,
        get_inertial_root(robot),
        read_inertial_parameters(robot.model),
        down,
        across,
    )


@dataclass(frozen=True, eq=False, slots=True)
class ArmFit:
    """One arm as the torques have it."""

    nats: float  # log evidence of the torques as logged
    at: Array  # coefficients, in deviations of the priors at one, (p,)
    sigma: Array  # what is left of each torque [N m], (dof,)
    size: Array  # rms of each torque [N m], (dof,)
    braking: Array  # power that friction takes, in its deviations, (dof,)


def fit_arm(sums: ArmSums, torques: Torques, deviations: Array) -> ArmFit:
    """Fit one arm to all torques, by turns with what it leaves of each."""
    joints = np.arange(sums.dof)
    f, order = torques.factor, torques.order
    power = f**2 * sums.power[joints, order]
    logged = np.sqrt(sums.power[joints, order] / np.maximum(sums.rows, 1e-9))
    size = np.abs(f) * logged
    square = power - 2 * f * sums.cross[joints, order] + sums.model_power
    target = f[:, None] * sums.channel[joints, :, order] - sums.model
    # Noise is of the channel as it is logged: no factor makes it smaller.
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
    """Return how far the robot file must bend to each torque, and still misses it.

    Half the square of the bodies' coefficients, shared by the joints behind which they
    are, what friction gives instead of taking, and a remainder of more than a rough
    model leaves [nats]. Shape (dof,).

    Args:
        fit: Under a rough file.
    """
    bend = np.array([0.5 * np.sum((fit.at[sums.link(j)] / ROUGH) ** 2) for j in range(sums.dof)])
    bend[-1] *= (ROUGH / 3.0) ** 2
    missed = np.log(fit.sigma / np.maximum(CHECK.rough_rest * fit.size, _NOTHING))
    brakes = -(log_ndtr(fit.braking) + np.log(2))
    return bend + sums.rows * np.maximum(missed, 0.0) + np.maximum(brakes, 0.0)


def find_tilted_gravity(sums: ArmSums, torques: Torques) -> Array:
    """Return gravity as the torques turn it, within the tilt of a base. (3,)."""
    deviations = sums.deviations(GIVEN)
    deviations[sums.outer][:2] = 3.0
    fit = fit_arm(sums, torques, deviations)
    turned = sums.gravity + TILT * fit.at[sums.outer][:2] @ sums.across
    size = max(float(np.linalg.norm(turned)), _NOTHING)
    return turned * float(np.linalg.norm(sums.gravity)) / size


@dataclass(frozen=True, eq=False, slots=True)
class NominalShares:
    """Shares of the file's torque that each torque has, friction and offset apart."""

    ratio: Array  # (dof,)
    ratio_sd: Array  # (dof,)
    # What the file explains of what friction leaves, 0 to 1, (dof,).
    explained: Array
    load: Array  # size of the file's torque [N m], (dof,)

    def loaded(self, least_share: float = 0.1) -> Array:
        """Which joints carry the arm: others are off by any factor. (dof,), bool."""
        return self.load > least_share * self.load.max()


def fit_nominal_shares(sums: ArmSums, order: Array, weightless: bool = False) -> NominalShares:
    """Fit tau = share * nominal + friction + offset + rotor, joint by joint.

    A rough file, a load or a gear's losses leave the shares near one on the joints that
    carry the arm; torque in another unit, or without a part, does not.
    """
    plain = np.array(_PLAIN + ([WEIGHT] if weightless else []))
    joints, size = np.arange(sums.dof), len(plain) + 1
    use = LOCAL * joints[:, None] + plain
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
    # What the file alone explains: its coefficient over its own precision.
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
    """Return what else may explain a log, as deviations of the coefficients.

    Each effect of the library is among the columns of a joint, a tool or a base; flaws
    of the file are bodies of any size.
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
        balanced[sums.local(j)][WEIGHT] = 10.0
    return out


def is_possible(sums: ArmSums, fit: ArmFit) -> bool:
    """Whether no mass of a fit is clearly negative, and no weight turned over."""
    first = sums.outer.stop
    given = sums.bodies[::PER_LINK]
    masses = given + (sums.root @ fit.at[first:])[::PER_LINK]
    balance = SHARE * fit.at[[sums.local(j).start + WEIGHT for j in range(sums.dof)]]
    heavy = masses > -0.5 * given - 0.02 * given.sum()
    return bool(heavy.all() and (balance > -1.5).all())
