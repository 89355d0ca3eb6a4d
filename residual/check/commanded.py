"""Torque that was computed, and logged in place of a measured one.

A command follows from the reference alone: it is the same in every repeat, down to the
last bit, and the model of whoever made it explains all of it. A measured torque has the
noise of its sensor, and what no model has.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from residual.check.evidence import compute_row_rms
from residual.check.result import Fault, list_true_joints
from residual.check.thresholds import CHECK
from residual.errors import format_joint_numbers
from residual.recording import Array, Recording
from residual.robot.dynamics import PER_LINK, compute_inertial_regressor
from residual.robot.robot import Robot
from residual.signals.track import FilterSettings, filter_motion, interpolate_signals

_FILTERS = FilterSettings(kinematics=25.0)  # Hz: derivatives of a reference have no noise
_EDGE = 0.5  # s
_ROWS, _PER_COLUMN = 900, 4  # rows to use, and rows for each column at least
_SLOW = 0.1  # of the largest speed: nearer to a reversal friction differs


def find_commanded_torque(robot: Robot, recordings: Sequence[Recording]) -> list[Fault]:
    """Find torque that was computed, and logged in place of a measured one."""
    return _repeated(recordings) or _followed(robot, recordings)


def _repeated(recordings: Sequence[Recording]) -> list[Fault]:
    """Torques of two logs that are equal bit by bit while the angles are not."""
    rows = [tuple(set(map(bytes, x)) for x in (r.tau, r.q)) for r in recordings]
    for (one, first), (other, second) in combinations(zip(recordings, rows, strict=True), 2):
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
    moves = np.max([np.ptp(r.q_ref, axis=0) for r in recordings], axis=0) > CHECK.moving_rad
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
