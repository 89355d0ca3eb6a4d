"""Torque that is smoothed at its source, late, or was never measured.

A command follows from the reference alone: it is the same in every repeat, down to the
last bit, and the model of whoever made it explains all of it. A measured torque has the
noise of its sensor, and what no model has.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from residual.check.motion import Columns, Motion, columns, later_torques
from residual.check.physics import bent
from residual.check.reading import as_given, judge
from residual.check.result import DELAY, Fault
from residual.check.rules import CHECK
from residual.names import joints_listed, listed
from residual.recording import Array, Recording
from residual.robot.dynamics import PER_LINK, regressor
from residual.robot.robot import Robot
from residual.signals.spectrum import power_density
from residual.signals.track import Filters, motion_of

_NOTHING = 1e-16
# Derivatives of a reference have no noise: far above what an arm does.
_PLAN_FILTERS = Filters(kinematics=25.0)


def filtered(recordings: Sequence[Recording]) -> list[Fault]:
    """Find torques without the noise that every sensor has."""
    spectra = [_spectrum(r) for r in recordings if len(r.t) >= 4 * CHECK.segment]
    if not spectra:
        return []
    fall, noise = (
        np.min([s[0] for s in spectra], axis=0),
        np.max([s[1] for s in spectra], axis=0),
    )
    joints = tuple(
        int(j) + 1 for j in np.flatnonzero((fall > CHECK.fall) | (noise < CHECK.silent))
    )
    if not joints:
        return []
    words = (
        f"The torque of joints {listed(joints)} has next to no noise "
        f"towards half the sampling rate ({max(noise[j - 1] for j in joints):.2g} of "
        "its rms), where a sensor's is even: it was smoothed at its source."
    )
    return [Fault("filtered", joints, False, words)]


def _spectrum(recording: Recording) -> tuple[Array, Array]:
    """Fall of the torque's spectrum in dB, its noise as a share of its rms. (dof,)."""
    tau = recording.tau
    share, power = power_density(tau, CHECK.segment, robust=True)
    near, high = (
        power[(share >= low) & (share < top)].mean(axis=0)
        for low, top in (CHECK.near_band, CHECK.high_band)
    )
    size = np.maximum(np.var(tau, axis=0), 1e-200)
    fall = 10 * np.log10((near + _NOTHING * size) / (high + _NOTHING * size))
    constant = np.ptp(tau, axis=0) == 0
    return np.where(constant, 0.0, fall), np.where(
        constant, 1.0, np.sqrt(high / size / 2)
    )


def late(robot: Robot, motion: Motion, recordings: Sequence[Recording]) -> list[Fault]:
    """Find torque that belongs to earlier angles, or to later ones.

    The torque is moved back and forth in time: where it fits the motion best, all
    joints together, it belongs. No slope of a noisy torque is taken.
    """
    # In between the filtered torque is smooth enough for a polynomial.
    powers = (
        np.vander(x, len(CHECK.delay_shifts))
        for x in (CHECK.delay_shifts, CHECK.delays)
    )
    at_shifts, at_delays = powers
    between = at_delays @ np.linalg.inv(at_shifts)
    moved = later_torques(recordings, CHECK.delay_shifts)
    torques = np.einsum("ks,snj->jkn", between, moved)
    joints = columns(robot, motion)
    nats = np.array([_nats(motion, torques[j], j, own) for j, own in enumerate(joints)])
    delay, sd = _peak(nats.sum(axis=0))
    there = int(np.argmin(np.abs(CHECK.delays - delay)))
    agree = int(
        np.sum(nats[:, there] - nats[:, len(CHECK.delays) // 2] > CHECK.delay_agrees)
    )
    if abs(delay) < max(CHECK.least_delay, CHECK.delay_clear * sd) or agree < min(
        2, robot.dof
    ):
        return []
    words = (
        f"The torque comes {abs(1000 * delay):.0f} ms (+- {1000 * sd:.1f} ms) "
        f"{'later' if delay > 0 else 'earlier'} than the angles it belongs to, on "
        f"{agree} joints."
    )
    return [Fault(DELAY, (), False, words)]


def long_late(
    robot: Robot, motion: Motion, recordings: Sequence[Recording]
) -> list[Fault]:
    """Find torque so late that the log looks like that of another arm."""
    strain = {}
    for shift, tau in zip(
        CHECK.far_delays, later_torques(recordings, CHECK.far_delays), strict=True
    ):
        rows = replace(motion, tau=tau)
        strain[shift] = bent(judge(robot, rows, as_given(robot.dof)))
    best = min(strain, key=strain.__getitem__, default=0.0)
    if best == 0 or strain[best] >= CHECK.bent:
        return []
    when = "later" if best > 0 else "earlier"
    words = (
        f"The torque comes about {abs(best):.2g} s {when} than the angles it belongs "
        "to: moved by that it is this arm's, and as it is, that of none."
    )
    return [Fault(DELAY, (), False, words)]


def _nats(motion: Motion, torques: Array, joint: int, own: Columns) -> Array:
    """Log evidence of one torque at each delay, beside all that it may have. (k,)."""
    left, size = torques[:, own.rows] - own.nominal, _rms(motion.tau)
    if not left.size:
        return np.zeros(len(left))
    floor = max(
        CHECK.delay_nearest * size[joint], CHECK.delay_coupled * size.max(), 1e-12
    )
    sigma = max(CHECK.rough_start * size[joint], floor)
    for _ in range(4):
        a = own.values * (np.sqrt(motion.spread) / sigma)
        y = left.T * (np.sqrt(motion.spread) / sigma)
        at = np.linalg.solve(np.eye(a.shape[1]) + a.T @ a, a.T @ y)
        rest = np.mean((left.T - own.values @ at) ** 2, axis=0).min()
        nats = -0.5 * (np.sum(y**2, axis=0) - np.sum(y * (a @ at), axis=0))
        sigma = max(float(np.sqrt(rest)), floor)
    return nats


def _peak(nats: Array) -> tuple[float, float]:
    """The best delay and its deviation, by a parabola through the top [s]."""
    i = int(np.clip(np.argmax(nats), 1, len(nats) - 2))
    step = CHECK.delays[1] - CHECK.delays[0]
    bend = max(float(2 * nats[i] - nats[i - 1] - nats[i + 1]), 1e-12)
    move = 0.5 * float(nats[i + 1] - nats[i - 1]) / bend
    return float(CHECK.delays[i] + np.clip(move, -1, 1) * step), float(
        step / np.sqrt(bend)
    )


def _rms(x: Array) -> Array:
    return np.sqrt(np.mean(x**2, axis=0))


def commanded(robot: Robot, recordings: Sequence[Recording]) -> list[Fault]:
    """Find torque that was computed, and logged in place of a measured one."""
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
    certain = bool(
        nearest > CHECK.follows_away * max(worst, CHECK.follows / CHECK.follows_away)
    )
    joints = tuple(int(j) + 1 for j in np.flatnonzero(moves))
    words = (
        f"Expected torque with noise and with what no model has, got one that follows "
        f"from the reference alone to {100 * worst:.2g} % on {joints_listed(joints)} "
        "(measured ones: 3 % at best): it is a command or a feed-forward. Log the "
        "measured torque or current (columns of tau in --map)."
    )
    return [Fault("commanded", (), certain, words)]


def _rows(logs: Sequence[Recording], signal: str) -> tuple[Array, Array]:
    """Angles, speeds and accelerations of all logs by that signal, and their torque.

    Returns:
        Shapes (3, n, dof) and (n, dof).
    """
    parts, torques = [], []
    total = sum(len(r.t) for r in logs)
    every = max(1, total // CHECK.plan_rows)
    for log in logs:
        t, _, motion = motion_of(replace(log, q=getattr(log, signal)), _PLAN_FILTERS)
        use = np.flatnonzero(
            (t > t[0] + CHECK.plan_edge) & (t < t[-1] - CHECK.plan_edge)
        )[::every]
        parts.append(np.stack(motion)[:, use])
        columns = [np.interp(t[use], log.t, column) for column in log.tau.T]
        torques.append(np.column_stack(columns))
    return np.concatenate(parts, axis=1), np.concatenate(torques)


def _misfit(
    robot: Robot, j: int, wanted: Array, done: Array, torque: Array
) -> tuple[float, float]:
    """What a model of the reference leaves of one torque, as a share of its size.

    Returns:
        That; and how far the same model of the motion itself is off.
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
