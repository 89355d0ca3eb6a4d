"""The direction of gravity, which is checked before anything else.

With a body near that of the robot file, torque is linear in the direction of gravity
(METHOD 16.1). The directions along the axes and the one that is given are compared by
the evidence of one body in the torques of all joints, and the best are turned until no
tilt is left. No body changes its sign, or its size by more than its prior, to save a
direction.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from threading import Lock

import numpy as np
import pinocchio as pin
from cachetools import LRUCache, cached
from scipy.linalg import cho_factor, cho_solve

from residual.check.column_reading import ROUNDS
from residual.check.physics_columns import (
    BODY,
    OUTER,
    TILT,
    CheckMotion,
    PriorColumns,
    build_prior_columns,
    compute_gravity_axes,
    compute_nominal_torque,
)
from residual.check.result import MOUNTING, Fault, Repair
from residual.check.thresholds import CHECK
from residual.check.torque_shares import fit_nominal_shares, select_loaded_joints
from residual.errors import join_with_commas
from residual.recording import Array
from residual.robot.dynamics import PER_LINK, build_motion_key
from residual.robot.robot import Robot

REMOVED = "gravity_removed"
REMOVED_WORDS = (
    "Without the weight that the robot file gives the arm the torques are its own: the "
    "driver took gravity out before it was logged. Log the torque as measured, or say "
    "so in robot.toml, [robot]: gravity = [0, 0, 0]"
)
_TILTS, _NOTHING = 2, 1e-300
_SCALES = (0.1, 0.3, 1.0)  # of the body's prior, chosen by evidence


@dataclass(frozen=True, eq=False, slots=True)
class JointSums:
    """Sums of one joint's rows over the coefficients of all joints."""

    gram: Array
    model: Array
    torque: Array
    squares: tuple[float, float, float]  # torque^2, torque * model, model^2
    rows: float
    floor: float


def sum_joint_rows(motion: CheckMotion, joints: list[PriorColumns]) -> list[JointSums]:
    """Own columns of each joint side by side, those of the body and outside common."""
    dof, out = len(joints), []
    common = OUTER + PER_LINK * dof
    own = [joint.values.shape[1] - common for joint in joints]
    starts = np.concatenate([[0], np.cumsum(own)])
    strongest = np.sqrt(np.mean(motion.tau**2, axis=0).max())
    for j, joint in enumerate(joints):
        values = np.zeros((len(joint.nominal), starts[-1] + common))
        values[:, starts[j] : starts[j + 1]] = joint.values[:, : own[j]]
        values[:, starts[-1] :] = joint.values[:, own[j] :]
        tau, model = motion.tau[joint.rows, j], joint.nominal
        pairs = ((tau, tau), (tau, model), (model, model))
        weight, rows = motion.spread, motion.spread * len(tau)
        squares = tuple(weight * float(a @ b) for a, b in pairs)
        size = np.sqrt(squares[0] / max(rows, 1e-9))
        floor = max(0.01 * size, 0.001 * strongest, 1e-12)
        sums = (weight * values.T @ x for x in (values, model, tau))
        out.append(JointSums(*sums, squares, rows, floor))
    return out


def fit_common_body(parts: list[JointSums], prior: Array) -> tuple[Array, Array, float]:
    """Fit one body to all torques, by turns with what it leaves of each.

    Args:
        prior: Precision of each coefficient about none.

    Returns:
        What is left of each torque [N m], (dof,); the coefficients; log evidence.
    """
    sigma = np.array([part.floor for part in parts])
    for _ in range(ROUNDS):
        _, at, _ = _solve_body(parts, sigma, prior)
        for j, part in enumerate(parts):
            power, cross, model = part.squares
            left = power - 2 * cross + model - 2 * at @ (part.torque - part.model)
            left = max(float(left + at @ part.gram @ at), 0.0)
            sigma[j] = max(np.sqrt(left / max(part.rows, 1e-9)), part.floor)
    square, at, size = _solve_body(parts, sigma, prior)
    noise = sum(part.rows * np.log(sd) for part, sd in zip(parts, sigma, strict=True))
    return sigma, at, float(-0.5 * (square + size) - noise)


def _solve_body(
    parts: list[JointSums], sigma: Array, prior: Array
) -> tuple[float, Array, float]:
    """Quadratic form of the rest, coefficients, and log determinant."""
    sums, square = 0.0, 0.0
    gram = np.diag(prior)
    for part, sd in zip(parts, sigma, strict=True):
        power, cross, model = part.squares
        gram += part.gram / sd**2
        sums = sums + (part.torque - part.model) / sd**2
        square += (power - 2 * cross + model) / sd**2
    unit = 1 / np.sqrt(np.diag(gram))
    scaled = gram * np.outer(unit, unit)
    np.fill_diagonal(scaled, 1 + 1e-12)
    factor = cho_factor(scaled)
    at = unit * cho_solve(factor, unit * sums)
    size = 2 * float(np.log(np.diag(factor[0]) / unit).sum())
    size -= float(np.log(prior).sum())
    return square - float(sums @ at), at, size


@dataclass(frozen=True, eq=False, slots=True)
class GravityFit:
    """An arm as it would stand under one direction of gravity."""

    gravity: Array  # in the base frame [m/s^2], (3,)
    parts: list[JointSums]
    nats: float  # log evidence of the torques
    scale: float  # of the body's prior by which it is so
    next_gravities: tuple[
        Array, ...
    ]  # where the remaining tilt asks to turn it, (3,) each


@dataclass(frozen=True, eq=False, slots=True)
class MountingFault:
    """Another direction of gravity than that of the robot file."""

    fault: Fault
    robot: Robot  # the arm as it is mounted
    nats: float  # log evidence of the torques with it


def find_mounting_fault(robot: Robot, motion: CheckMotion) -> MountingFault | None:
    """Find an arm that is mounted otherwise than its file says."""
    given = np.asarray(robot.model.gravity.linear)
    if not np.linalg.norm(given):
        return None
    was, best = _best_gravity(robot, motion)
    none = _weightless(robot, motion)
    angle, gain = _angle(best.gravity, given), best.nats - was.nats
    otherwise = angle >= CHECK.tilted_rad and gain >= CHECK.suspect_nats
    if none.nats > (best if otherwise else was).nats + CHECK.odds_nats:
        gain = none.nats - was.nats
        words = (
            f"{REMOVED_WORDS}. It fits better by {gain:.0f} nats; of a load the weight "
            "may be there."
        )
        fault = Fault(REMOVED, (), gain > CHECK.suspect_nats, words)
        return MountingFault(fault, copy_with_gravity(robot, np.zeros(3)), none.nats)
    if not otherwise:
        return None
    # Most joints that carry the arm must have the file's torque, as it now is.
    shares = fit_nominal_shares(copy_with_gravity(robot, best.gravity), motion)
    own = select_loaded_joints(shares)
    off = np.abs(np.log(np.abs(shares.ratio[own]) + _NOTHING))
    near = off < np.log(CHECK.joint_ratio)
    near &= shares.explained[own] > CHECK.explained_least
    if 2 * near.sum() <= len(near):
        return None
    file, found = (join_with_commas(g + 0.0, ".3g") for g in (given, best.gravity))
    words = (
        f"Gravity points along {file} in the robot file; along {found} m/s^2, "
        f"{np.degrees(angle):.0f} degrees away, the torques fit better by {gain:.0f} "
        f"nats: the arm {_mounting_words(angle)}."
    )
    repairs = (Repair("robot", gravity=tuple(map(float, best.gravity))),)
    fault = Fault(MOUNTING, (), gain > CHECK.suspect_nats, words, repairs)
    return MountingFault(fault, copy_with_gravity(robot, best.gravity), best.nats)


def compute_body_evidence(robot: Robot, motion: CheckMotion) -> float:
    """Return the log evidence of one body in all torques, gravity as given."""
    return _gravity_fit(robot, motion, np.asarray(robot.model.gravity.linear)).nats


@cached(
    LRUCache(32),
    key=lambda robot, g: build_motion_key(robot, np.array(g, float)),
    lock=Lock(),
)
def copy_with_gravity(robot: Robot, gravity: Sequence[float] | Array) -> Robot:
    """Return the arm under another gravity [m/s^2]. (3,)."""
    model = pin.Model(robot.model)
    model.gravity.linear = np.asarray(gravity, dtype=float)
    return replace(robot, model=model)


def _mounting_words(angle: float) -> str:
    ways = (np.pi, "hangs from a ceiling"), (np.pi / 2, "is mounted on a wall")
    for at, words in ways:
        if abs(angle - at) < CHECK.tilted_rad:
            return words
    return f"stands inclined by {np.degrees(angle):.0f} degrees"


def _best_gravity(robot: Robot, motion: CheckMotion) -> tuple[GravityFit, GravityFit]:
    """The arm as given, and under the best direction of gravity of the same size."""
    given = np.asarray(robot.model.gravity.linear)
    size = float(np.linalg.norm(given))
    every = size * np.vstack([np.eye(3), -np.eye(3)])
    axes = [x for x in every if _angle(x, given) > CHECK.tilted_rad / 2]
    was, *tried = (_gravity_fit(robot, motion, x) for x in (given, *axes))
    tried.sort(key=lambda stand: -stand.nats)
    # A good direction stands out: nothing more is asked of an upright arm.
    clear = was.nats > tried[0].nats + CHECK.suspect_nats
    starts = [was] if clear else [was, *tried[:3]]
    best = max((_refined(robot, motion, s) for s in starts), key=lambda s: s.nats)
    axis = size * np.sign(best.gravity) * (np.abs(best.gravity) > 0.9 * size)
    if not axis.any() or _angle(axis, best.gravity) > CHECK.tilted_rad:
        return was, best
    # Arms are mounted along an axis; a load turns what the torques say by some degrees.
    near = _gravity_fit(robot, motion, axis)
    return was, near if near.nats > best.nats - CHECK.odds_nats else best


def _angle(a: Array, b: Array) -> float:
    """Angle between two directions [rad]; none where one is nothing."""
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(np.arccos(np.clip(a @ b / size, -1, 1))) if size else 0.0


def _refined(robot: Robot, motion: CheckMotion, stand: GravityFit) -> GravityFit:
    """Turn gravity until no tilt is left that explains more."""
    for _ in range(12):
        tried = [_gravity_fit(robot, motion, step) for step in stand.next_gravities]
        best = max(tried, key=lambda s: s.nats)
        # A turn that is within what arms stand off gains nothing, and is nearer.
        if best.nats < stand.nats - 2.0:
            break
        turn, stand = _angle(best.gravity, stand.gravity), best
        if turn < 2e-3:  # rad
            break
    return stand


def _weightless(robot: Robot, motion: CheckMotion) -> GravityFit:
    """The arm without the weight of its file, as drivers report it, but for a load's.

    They know the weight to some share; it takes the place of a tilt.
    """
    inertia = compute_nominal_torque(copy_with_gravity(robot, np.zeros(3)), motion)
    joints = []
    for j, own in enumerate(build_prior_columns(robot, motion)):
        nominal, values = inertia[own.rows, j], own.values.copy()
        tilts = values.shape[1] - PER_LINK * robot.dof - OUTER
        values[:, tilts] = BODY * (own.nominal - nominal)
        values[:, tilts + 1] = 0.0
        joints.append(replace(own, nominal=nominal, values=values))
    return _fitted(sum_joint_rows(motion, joints), np.zeros(3), ())


def _gravity_fit(robot: Robot, motion: CheckMotion, gravity: Array) -> GravityFit:
    turned = copy_with_gravity(robot, gravity)
    parts = sum_joint_rows(motion, build_prior_columns(turned, motion, robot))
    _, across = compute_gravity_axes(turned)
    stand = _fitted(parts, gravity, ())
    first = len(parts[0].gram) - OUTER - PER_LINK * robot.dof
    steps = []
    for s in dict.fromkeys((_SCALES[0], stand.scale)):
        _, at, _ = fit_common_body(parts, _prior(parts, s, 3.0))
        to = gravity + TILT * at[first : first + _TILTS] @ across
        size = max(float(np.linalg.norm(to)), _NOTHING)
        steps.append(to * np.linalg.norm(gravity) / size)
    return replace(stand, next_gravities=tuple(steps))


def _fitted(
    parts: list[JointSums], gravity: Array, steps: tuple[Array, ...]
) -> GravityFit:
    fits = {s: fit_common_body(parts, _prior(parts, s)) for s in _SCALES}
    scale = max(fits, key=lambda s: fits[s][2])
    return GravityFit(gravity, parts, fits[scale][2], scale, steps)


def _prior(parts: list[JointSums], scale: float, tilt: float | None = None) -> Array:
    """Precision of each coefficient: the body's prior times a scale, and a load.

    Tilts of a few degrees are an effect of the arm, and no other mounting.
    """
    count = len(parts[0].gram)
    body = count - PER_LINK * len(parts)
    out = np.ones(count)
    out[body:-PER_LINK] = scale**-2
    out[-PER_LINK:] = 3.0**-2
    out[body - OUTER : body - OUTER + _TILTS] = (tilt or 0.3) ** -2
    return out
