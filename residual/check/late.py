"""Torque that is smoothed at its source, or comes later than the angles."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from residual.check.columns import Columns, columns
from residual.check.motion import Motion, later_torques
from residual.check.physics import BENT, bent
from residual.check.reading import as_given, judge
from residual.check.result import DELAY, Fault
from residual.names import listed
from residual.recording import Array, Recording
from residual.robot.robot import Robot
from residual.signals.spectrum import power_density

_SEGMENT = 128  # samples: short enough that most segments hold no reversal
# Shares of the sampling rate: noise of a sensor is as strong in both.
_NEAR, _HIGH = (0.12, 0.2), (0.35, 0.47)
_FALL = 20.0  # dB from one to the other: a filter of second order at least
_SILENT = 1e-4  # of the rms: below it no sensor's noise is
_NOTHING = 1e-16
_SHIFTS = (-0.08, -0.04, 0.0, 0.04, 0.08)  # s by which the torque is moved
_DELAYS = np.linspace(-0.08, 0.08, 41)  # s that are tried
_FAR = np.linspace(-1.0, 1.0, 51).round(2)  # s, where it looks like another arm's
_LEAST = 0.006  # s
_CLEAR, _AGREES = 4.0, 2.0  # deviations of all joints; nats of each that counts
_NEAREST, _COUPLED = (
    0.01,
    0.003,
)  # of the torque, of the strongest: models are no nearer
_ROUGH = 0.05  # of the torque, to begin with


def filtered(recordings: Sequence[Recording]) -> list[Fault]:
    """Find torques without the noise that every sensor has.

    Args:
        recordings: Logs of one arm.
    """
    spectra = [_spectrum(r) for r in recordings if len(r.t) >= 4 * _SEGMENT]
    if not spectra:
        return []
    fall, noise = (
        np.min([s[0] for s in spectra], axis=0),
        np.max([s[1] for s in spectra], axis=0),
    )
    joints = tuple(
        int(j) + 1 for j in np.flatnonzero((fall > _FALL) | (noise < _SILENT))
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
    share, power = power_density(tau, _SEGMENT, robust=True)
    near, high = (
        power[(share >= low) & (share < top)].mean(axis=0)
        for low, top in (_NEAR, _HIGH)
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

    Args:
        robot: The arm.
        motion: Rows of its logs.
        recordings: The logs, whose columns are read rightly.
    """
    # In between the filtered torque is smooth enough for a polynomial.
    powers = (np.vander(x, len(_SHIFTS)) for x in (_SHIFTS, _DELAYS))
    at_shifts, at_delays = powers
    between = at_delays @ np.linalg.inv(at_shifts)
    moved = later_torques(recordings, _SHIFTS)
    torques = np.einsum("ks,snj->jkn", between, moved)
    joints = columns(robot, motion)
    nats = np.array([_nats(motion, torques[j], j, own) for j, own in enumerate(joints)])
    delay, sd = _peak(nats.sum(axis=0))
    there = int(np.argmin(np.abs(_DELAYS - delay)))
    agree = int(np.sum(nats[:, there] - nats[:, len(_DELAYS) // 2] > _AGREES))
    if abs(delay) < max(_LEAST, _CLEAR * sd) or agree < min(2, robot.dof):
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
    """Find torque so late that the log looks like that of another arm.

    Args:
        robot: The arm.
        motion: Rows of its logs.
        recordings: The logs, whose columns are read rightly.
    """
    strain = {}
    for shift, tau in zip(_FAR, later_torques(recordings, _FAR), strict=True):
        rows = replace(motion, tau=tau)
        strain[shift] = bent(judge(robot, rows, as_given(robot.dof)))
    best = min(strain, key=strain.__getitem__, default=0.0)
    if best == 0 or strain[best] >= BENT:
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
    floor = max(_NEAREST * size[joint], _COUPLED * size.max(), 1e-12)
    sigma = max(_ROUGH * size[joint], floor)
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
    step = _DELAYS[1] - _DELAYS[0]
    bend = max(float(2 * nats[i] - nats[i - 1] - nats[i + 1]), 1e-12)
    move = 0.5 * float(nats[i + 1] - nats[i - 1]) / bend
    return float(_DELAYS[i] + np.clip(move, -1, 1) * step), float(step / np.sqrt(bend))


def _rms(x: Array) -> Array:
    return np.sqrt(np.mean(x**2, axis=0))
