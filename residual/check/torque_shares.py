"""Torque of another joint or unit, without a part, or computed in place of measured.

Drives report currents, and drivers take weight or friction out of what they report. Of
a rough robot file, a load or a gear's losses the joints that carry the arm keep most of
their share; all of them together lose it by the report alone. And where a slow log lets
a rough body bend to the torque of any joint, the robot file as it is bends to none: it
explains most of what friction leaves of a torque, and nothing of an exchanged one.

A command follows from the reference alone: it is the same in every repeat, down to the
last bit, and the model of whoever made it explains all of it. A measured torque has the
noise of its sensor, and what no model has.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from threading import Lock

import numpy as np
from cachetools import LRUCache, cached

from residual.check.column_reading import GEAR
from residual.check.physics_columns import (
    CheckMotion,
    compute_nominal_torque,
    compute_row_rms,
)
from residual.check.result import Fault, Repair, list_true_joints
from residual.check.thresholds import CHECK
from residual.errors import format_joint_numbers
from residual.recording import Array, Recording
from residual.robot.dynamics import (
    PER_LINK,
    compute_gravity_torque,
    compute_inertial_regressor,
)
from residual.robot.robot import Robot
from residual.signals.track import FilterSettings, filter_motion, interpolate_signals

_NOTHING = 1e-12
_ALIKE = 1e-9  # of the power of a direction of the columns: below it is none
_SILENT = (np.nan, np.inf, 0.0, 0.0)


_FILTERS = FilterSettings(
    kinematics=25.0
)  # Hz: derivatives of a reference have no noise
_EDGE = 0.5  # s
_ROWS, _PER_COLUMN = 900, 4  # rows to use, and rows for each column at least
_SLOW = 0.1  # of the largest speed: nearer to a reversal friction differs


@dataclass(frozen=True, eq=False, slots=True)
class NominalShares:
    """Shares of the model that each torque has; not a number where it does not show."""

    # Share of the whole nominal torque, and its deviation, (dof,).
    ratio: Array
    ratio_sd: Array
    # What the nominal torque explains of what friction leaves, 0 to 1, (dof,).
    explained: Array
    load: Array  # size of the nominal torque [N m], (dof,)


def fit_nominal_shares(
    robot: Robot, motion: CheckMotion, weight_removed: bool = False
) -> NominalShares:
    """Return the shares of a motion, by a plain regression joint by joint.

    tau = share * nominal + a qd + b sign(qd) + c + d qdd, the friction, offset and
    rotor of any size. A rough file, a load or a gear's losses leave the shares near
    one on the joints that carry the arm; torque in another unit, or without a part,
    does not.

    Args:
        weight_removed: Whether a driver took the weight out, but for what it knows it
            by.
    """
    nominal = compute_nominal_torque(robot, motion)
    weight = np.zeros_like(nominal)
    if weight_removed:
        down = robot.model.gravity.linear
        weight = compute_gravity_torque(robot.model, motion.q, down)
        strong = compute_row_rms(weight)
        weight[:, strong <= 1e-6 * strong.max()] = 0.0
        nominal = nominal - weight
    rows = [
        _joint(motion, j, nominal[:, j], weight[:, j], weight_removed)
        for j in range(robot.dof)
    ]
    return NominalShares(*(np.array(column) for column in zip(*rows, strict=True)))


def select_loaded_joints(shares: NominalShares, least_share: float = 0.1) -> Array:
    """Return which joints carry the arm: others are off by any factor. (dof,)."""
    return shares.load > least_share * shares.load.max()


def _joint(
    motion: CheckMotion, j: int, nominal: Array, weight: Array, removed: bool
) -> tuple:
    """The shares of one joint, in the order of the record."""
    use = motion.moving[:, j]
    if use.sum() < 20:
        return _SILENT
    tau, qd, qdd = (x[use, j] for x in (motion.tau, motion.qd, motion.qdd))
    rest, without = _fit_friction(motion.spread, tau, qd, qdd)
    columns = [nominal[use], *([weight[use]] if removed else []), rest]
    ratio, sure, left = _fit(np.column_stack(columns), tau, motion.spread)
    there = removed and bool(weight.any())
    if there and abs(ratio[1]) > CHECK.weight_share * abs(ratio[0]):
        left = without  # it is there
    return (
        ratio[0],
        np.sqrt(sure[0, 0]),
        1 - left / max(without, _NOTHING),
        compute_row_rms(nominal[use]),
    )


# Changes of the arm, and of the columns of other joints, leave these rows as they are.
@cached(
    LRUCache(256),
    key=lambda spread, *rows: (spread, *(x.tobytes() for x in rows)),
    lock=Lock(),
)
def _fit_friction(
    spread: float, tau: Array, qd: Array, qdd: Array
) -> tuple[Array, float]:
    """Columns of friction, offset and rotor, and the mean square that they leave."""
    slow = max(0.05 * float(compute_row_rms(qd)), _NOTHING)
    rest = np.column_stack([qd, np.tanh(qd / slow), np.ones_like(qd), qdd])
    return rest, _fit(rest, tau, spread)[2]


def _fit(columns: Array, tau: Array, spread: float) -> tuple[Array, Array, float]:
    """Coefficients, their covariance, and the mean square that is left.

    Rows that are near in time count as one: ``spread`` of each is independent. What is
    not there, or not to be told from others, is as uncertain as it can be.
    """
    size = compute_row_rms(columns) + _NOTHING
    scaled = columns / size
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    values = np.maximum(values, _ALIKE * len(scaled))
    inverse = (vectors / values) @ vectors.T
    at = inverse @ (scaled.T @ tau)
    left = float(np.mean((tau - scaled @ at) ** 2))
    free = len(scaled) / max(len(scaled) - len(at), 1)
    covariance = inverse * free * left / spread / np.outer(size, size)
    gone = size < 2 * _NOTHING
    covariance[gone, gone] = np.inf
    return at / size, covariance, left


def compute_torque_factors(shares: NominalShares) -> Array | None:
    """What each torque is to be multiplied by, where all that shows it is far off.

    The joints that carry the arm decide: at a wrist a rough file is off by any factor.

    Returns:
        Factors, not a number for joints that show none. Shape (dof,). None where some
        joint has the share that it should have.
    """
    sharp = shares.ratio_sd < CHECK.ratio_sd * np.abs(shares.ratio)
    shows = sharp & (shares.explained > CHECK.explained_least)
    few = min(2, len(shows))
    own = shares.ratio[shows & select_loaded_joints(shares)]
    if len(own) < few:  # of the strongest, one may hide an effect
        own = shares.ratio[shows & select_loaded_joints(shares, CHECK.weak_joint_share)]
    if len(own) < few or own.min() <= 0:
        return None
    if own.max() > 1 / CHECK.unit_ratio and own.min() < CHECK.unit_ratio:
        return None
    return np.where(shows & (shares.ratio > 0), 1 / shares.ratio, np.nan)


def build_torque_unit_fault(
    robot: Robot, required_factors: Array, shares: NominalShares
) -> Fault:
    """Say what torques in another unit are to be multiplied by, drive by drive."""
    sure = np.isfinite(required_factors) & select_loaded_joints(
        shares, CHECK.weak_joint_share
    )
    shown = np.flatnonzero(sure)
    own = required_factors[shown]
    if own.max() < CHECK.factor_spread * own.min():
        factors = f"about {np.median(own):.2g}"
    else:
        each = (f"{f:.2g} (joint {j + 1})" for j, f in zip(shown, own, strict=True))
        factors = f"about {', '.join(each)}"
    silent = np.flatnonzero(~sure) + 1
    rest = (
        f"; too little shows of {format_joint_numbers(silent)}" if len(silent) else ""
    )
    words = (
        f"Expected torques in N m, got values that fit this arm only times {factors}"
        f"{rest}: currents of the motors, torque before the gears, or the file of an "
        "arm of another size. "
    )
    joints = tuple(range(1, robot.dof + 1))
    off = np.exp(
        abs(
            np.mean(
                np.log(
                    required_factors[
                        np.isfinite(required_factors) & select_loaded_joints(shares)
                    ]
                )
            )
        )
    )
    certain = bool(off > CHECK.unit_certain_ratio)
    for kind, known in (
        ("torque_unit", robot.torque_per_unit),
        ("gear_ratio", robot.gear_ratio),
    ):
        # As far as a rough file tells, factors are those of the robot file.
        if known is not None and _alike(own / np.abs(known[shown])):
            repair = Repair("tau", joints, scale=tuple(np.abs(known).tolist()))
            words += "robot.toml has the factors that fix it."
            return Fault(kind, (), certain, words, (repair,))
    for unit in (1e-3, 1e3, 1e-2):
        if _alike(own / unit):
            words += f"Times {unit:g} all of them fit."
            return Fault(
                "torque_unit", (), certain, words, (Repair("tau", scale=unit),)
            )
    rough = np.where(sure, required_factors, float(np.median(own)))
    words += (
        "Give the drives' own N m per logged unit (torque constant times gear ratio) "
        "where they are known: torque_per_unit = [...] in robot.toml, [joints], and "
        'unit = "A" in the line tau of --map; the factors of the line here are rough.'
    )
    repair = Repair("tau", joints, scale=tuple(float(f"{f:.2g}") for f in rough))
    geared = np.median(own) > GEAR / 3  # so small is a motor's torque
    kind = "gear_ratio" if geared else "torque_unit"
    return Fault(kind, (), certain, words, (repair,))


def _alike(away: Array) -> bool:
    """Whether factors are one another but for what a rough file or a load does."""
    off = np.abs(np.log(away))
    return bool(
        off.max() < np.log(CHECK.joint_ratio)
        and np.median(off) < np.log(CHECK.unit_ratio)
    )


def find_commanded_torque(robot: Robot, recordings: Sequence[Recording]) -> list[Fault]:
    """Find torque that was computed, and logged in place of a measured one."""
    return _repeated(recordings) or _followed(robot, recordings)


def _repeated(recordings: Sequence[Recording]) -> list[Fault]:
    """Torques of two logs that are equal bit by bit while the angles are not."""
    rows = [tuple(set(map(bytes, x)) for x in (r.tau, r.q)) for r in recordings]
    for (one, first), (other, second) in combinations(
        zip(recordings, rows, strict=True), 2
    ):
        tau, q = (len(a & b) / len(a) for a, b in zip(first, second, strict=True))
        if len(first[0]) < 50 or tau < CHECK.repeated_share or q > tau / 2:
            continue
        words = (
            f"Expected torque with the noise of a sensor, got {100 * tau:.0f} % of the "
            f"torques of {one.id} again in {other.id}, bit for bit on all joints, "
            "while the angles differ: it is a command. Log the measured torque or "
            "current (columns of tau in --map)."
        )
        return [Fault("commanded", (), True, words)]
    return []


def _followed(robot: Robot, recordings: Sequence[Recording]) -> list[Fault]:
    """Torque that a model explains by the reference alone, on all joints that move."""
    if any(r.q_ref is None for r in recordings):
        return []
    planned, torque = _signal_rows(recordings, "q_ref")
    done, _ = _signal_rows(recordings, "q")
    moves = (
        np.max([np.ptp(r.q_ref, axis=0) for r in recordings], axis=0) > CHECK.moving_rad
    )
    worst, nearest = 0.0, np.inf
    for j in np.flatnonzero(moves):
        speed = np.abs(planned[1, :, j])
        use = speed > _SLOW * speed.max()
        columns, tau = _command_columns(robot, int(j), planned[:, use]), torque[use, j]
        rows, count = columns.shape
        if rows < _PER_COLUMN * count:
            return []
        size, scale = float(np.std(tau)) + 1e-12, compute_row_rms(columns) + 1e-12
        at = np.linalg.lstsq(columns / scale, tau, rcond=1e-10)[0] / scale
        free = np.sqrt(rows / (rows - count))
        left = float(np.std(tau - columns @ at) * free) / size
        if not left < CHECK.command_residual:
            return []
        moved = _command_columns(robot, int(j), done[:, use]) @ at
        worst = max(worst, left)
        nearest = min(nearest, float(np.std(tau - moved)) / size)
    if not worst:
        return []
    # Where the arm follows its reference well, a quiet measurement looks the same.
    certain = bool(nearest > max(CHECK.command_ratio * worst, CHECK.command_residual))
    words = (
        f"Expected torque with noise and with what no model has, got one that follows "
        f"from the reference alone to {100 * worst:.2g} % on "
        f"{format_joint_numbers(list_true_joints(moves))} (measured ones: 3 % at "
        f"best): it is a "
        "command or a feed-forward. Log the measured torque or current (columns of "
        "tau in --map)."
    )
    return [Fault("commanded", (), certain, words)]


def _signal_rows(logs: Sequence[Recording], signal: str) -> tuple[Array, Array]:
    """Angles, speeds and accelerations by that signal, (3, n, dof), and torque."""
    parts, torques = [], []
    every = max(1, sum(len(r.t) for r in logs) // _ROWS)
    for log in logs:
        t, _, motion = filter_motion(replace(log, q=getattr(log, signal)), _FILTERS)
        use = np.flatnonzero((t > t[0] + _EDGE) & (t < t[-1] - _EDGE))[::every]
        parts.append(np.stack(motion)[:, use])
        torques.append(interpolate_signals(t[use], log.t, log.tau))
    return np.concatenate(parts, axis=1), np.concatenate(torques)


def _command_columns(robot: Robot, j: int, motion: Array) -> Array:
    """Any body from this joint on, friction, a rotor and an offset. Shape (n, p)."""
    q, qd, qdd = motion
    body = compute_inertial_regressor(robot.model, q, qd, qdd)[:, j, PER_LINK * j :]
    v, a = qd[:, j], qdd[:, j]
    return np.column_stack([body, v, np.sign(v), v * np.abs(v), a, np.ones_like(v)])
