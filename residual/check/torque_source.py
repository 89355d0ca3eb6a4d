"""Torque that is smoothed at its source, or was never measured."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from residual.check.result import Fault, joints_of
from residual.check.rules import CHECK
from residual.errors import joints_listed, listed
from residual.recording import Array, Recording
from residual.robot.dynamics import PER_LINK, regressor
from residual.robot.robot import Robot
from residual.signals.filters import power_density
from residual.signals.track import Filters, at_times, motion_of

_NOTHING = 1e-16


def filtered(recordings: Sequence[Recording]) -> list[Fault]:
    """Find torques without the noise that every sensor has."""
    joints, noise = smoothed(recordings)
    if not joints:
        return []
    words = (
        f"The torque of joints {listed(joints)} has next to no noise "
        f"towards half the sampling rate ({noise:.2g} of "
        "its rms), where a sensor's is even: it was smoothed at its source."
    )
    return [Fault("filtered", joints, False, words)]


def smoothed(recordings: Sequence[Recording]) -> tuple[tuple[int, ...], float]:
    """Return joints (from 1) whose torque was smoothed at its source in all logs.

    Also the noise that is left of them, at most, as a share of the torque's rms.
    """
    long = [r.tau for r in recordings if len(r.t) >= 4 * CHECK.segment]
    if not long:
        return (), 0.0
    falls, noises = zip(*map(_spectrum, long), strict=True)
    fall, noise = np.min(falls, axis=0), np.max(noises, axis=0)
    joints = joints_of((fall > CHECK.fall) | (noise < CHECK.silent))
    return joints, float(max((noise[j - 1] for j in joints), default=0.0))


def _spectrum(tau: Array) -> tuple[Array, Array]:
    """Fall of the torque's spectrum in dB, its noise as a share of its rms. (dof,)."""
    share, power = power_density(tau, CHECK.segment, robust=True)
    bands = CHECK.near_band, CHECK.high_band
    near, high = (power[(share >= a) & (share < b)].mean(axis=0) for a, b in bands)
    size = np.maximum(np.var(tau, axis=0), 1e-200)
    fall = 10 * np.log10((near + _NOTHING * size) / (high + _NOTHING * size))
    noise, constant = np.sqrt(high / size / 2), np.ptp(tau, axis=0) == 0
    return np.where(constant, 0.0, fall), np.where(constant, 1.0, noise)


def commanded(robot: Robot, recordings: Sequence[Recording]) -> list[Fault]:
    """Find torque that was computed, and logged in place of a measured one.

    A command follows from the reference alone: it is the same in every repeat, down to
    the last bit, and the model of whoever made it explains all of it. A measured torque
    has the noise of its sensor, and what no model has.
    """
    return _repeated(recordings) or _followed(robot, recordings)


def _repeated(recordings: Sequence[Recording]) -> list[Fault]:
    """Torques of two logs that are equal bit by bit while the angles are not."""
    rows = [tuple(set(map(bytes, x)) for x in (r.tau, r.q)) for r in recordings]
    for (one, own), (other, others) in combinations(
        zip(recordings, rows, strict=True), 2
    ):
        tau, q = (len(a & b) / len(a) for a, b in zip(own, others, strict=True))
        if len(own[0]) < CHECK.repeats_least or tau < CHECK.repeats or q > tau / 2:
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
    logs = [r for r in recordings if r.q_ref is not None]
    if not logs or len(logs) < len(recordings):
        return []
    wanted, torque = _rows(logs, "q_ref")
    done, _ = _rows(logs, "q")
    moves = np.max([np.ptp(r.q_ref, axis=0) for r in logs], axis=0) > CHECK.moves
    worst, nearest = 0.0, np.inf
    for j in np.flatnonzero(moves):
        left, off = _misfit(robot, int(j), wanted, done, torque)
        if not left < CHECK.follows:
            return []
        worst, nearest = max(worst, left), min(nearest, off)
    if not worst:
        return []
    # Where the arm does what it is told to, a quiet measurement looks the same.
    certain = bool(nearest > max(CHECK.follows_away * worst, CHECK.follows))
    joints = joints_of(moves)
    words = (
        f"Expected torque with noise and with what no model has, got one that follows "
        f"from the reference alone to {100 * worst:.2g} % on {joints_listed(joints)} "
        "(measured ones: 3 % at best): it is a command or a feed-forward. Log the "
        "measured torque or current (columns of tau in --map)."
    )
    return [Fault("commanded", (), certain, words)]


def _rows(logs: Sequence[Recording], signal: str) -> tuple[Array, Array]:
    """Angles, speeds and accelerations by that signal, (3, n, dof), and torque."""
    parts, torques = [], []
    filters, edge = Filters(kinematics=CHECK.plan_filter), CHECK.plan_edge
    every = max(1, sum(len(r.t) for r in logs) // CHECK.plan_rows)
    for log in logs:
        t, _, motion = motion_of(replace(log, q=getattr(log, signal)), filters)
        use = np.flatnonzero((t > t[0] + edge) & (t < t[-1] - edge))[::every]
        parts.append(np.stack(motion)[:, use])
        torques.append(at_times(t[use], log.t, log.tau))
    return np.concatenate(parts, axis=1), np.concatenate(torques)


def _misfit(
    robot: Robot, j: int, wanted: Array, done: Array, torque: Array
) -> tuple[float, float]:
    """What a model of the reference leaves of one torque, as a share of its size.

    And how far the same model of the motion itself is off.
    """
    speed = np.abs(wanted[1, :, j])
    use = speed > CHECK.plan_slow * speed.max()
    columns = _columns(robot, j, wanted[:, use])
    if len(columns) < CHECK.plan_per_column * columns.shape[1]:
        return np.inf, np.inf
    tau = torque[use, j]
    size = float(np.std(tau)) + 1e-12
    scale = np.sqrt(np.mean(columns**2, axis=0)) + 1e-12
    at = np.linalg.lstsq(columns / scale, tau, rcond=1e-10)[0]
    left = tau - columns / scale @ at
    moved = _columns(robot, j, done[:, use]) / scale @ at
    free = len(columns) / (len(columns) - columns.shape[1])
    return float(np.std(left) * np.sqrt(free)) / size, float(np.std(tau - moved)) / size


def _columns(robot: Robot, j: int, motion: Array) -> Array:
    """Any body from this joint on, friction, a rotor and an offset. Shape (n, p)."""
    q, qd, qdd = motion
    body = regressor(robot.model, q, qd, qdd)[:, j, PER_LINK * j :]
    v, a = qd[:, j], qdd[:, j]
    own = [v, np.sign(v), v * np.abs(v), a, np.ones_like(v)]
    return np.column_stack([body, *own])
