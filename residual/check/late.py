"""Torque that is smoothed at its source, or comes later than the angles."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.signal import welch

from residual.check.columns import Columns, columns
from residual.check.motion import Motion, thin_rows
from residual.check.result import DELAY, Fault
from residual.names import listed
from residual.recording import Array, Recording
from residual.robot.robot import Robot

_SEGMENT = 128  # samples: short enough that most segments hold no reversal
# Shares of the sampling rate: noise of a sensor is as strong in both.
_NEAR, _HIGH = (0.12, 0.2), (0.35, 0.47)
_FALL = 20.0  # dB from one to the other: a filter of second order at least
_SILENT = 1e-4  # of the rms: below it no sensor's noise is
_NOTHING = 1e-16
_STEP, _USUAL = 0.005, 0.03  # s, of the derivative; deviation of delays
_LEAST = 0.006  # s
_CLEAR, _SINGLE = 4.0, 2.0  # deviations, of all joints and of single ones
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
    share, power = welch(
        tau, nperseg=_SEGMENT, window="blackmanharris", axis=0, average="median"
    )
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


def late(robot: Robot, recordings: Sequence[Recording]) -> list[Fault]:
    """Find torque that belongs to earlier angles, or to later ones.

    A delay adds its size times the derivative of the torque, in every joint alike.

    Args:
        robot: The arm.
        recordings: Its logs, whose columns are read rightly.
    """
    rows = [
        thin_rows([_shifted(r, s) for r in recordings]) for s in (0.0, _STEP, -_STEP)
    ]
    if any(each is None for each in rows):
        return []
    motion, after, before = rows
    slope = (after.tau - before.tau) / (2 * _STEP)
    joints = columns(robot, motion)
    found = [_delay(motion, slope, j, own) for j, own in enumerate(joints)]
    delays, sds = np.array(found).T
    weight = 1 / sds**2
    delay, sd = float(weight @ delays / weight.sum()), float(weight.sum() ** -0.5)
    agree = np.sum(delays * np.sign(delay) > _SINGLE * sds)
    if abs(delay) < max(_LEAST, _CLEAR * sd) or agree < min(2, robot.dof):
        return []
    words = (
        f"The torque comes {abs(1000 * delay):.0f} ms (+- {1000 * sd:.1f} ms) "
        f"{'later' if delay > 0 else 'earlier'} than the angles it belongs to, on "
        f"{agree} joints."
    )
    return [Fault(DELAY, (), False, words)]


def _delay(
    motion: Motion, slope: Array, joint: int, own: Columns
) -> tuple[float, float]:
    """Delay of one torque and its deviation, beside all else that it may have [s]."""
    tau, size = motion.tau[own.rows, joint], np.sqrt(np.mean(motion.tau**2, axis=0))
    wide = np.column_stack([own.values, -_USUAL * slope[own.rows, joint]])
    floor = max(_NEAREST * size[joint], _COUPLED * size.max(), 1e-12)
    sigma = max(_ROUGH * size[joint], floor)
    for _ in range(4):
        gram = np.eye(wide.shape[1]) + motion.spread * wide.T @ wide / sigma**2
        spread = np.linalg.inv(gram)
        left = tau - own.nominal
        at = spread @ (motion.spread * wide.T @ left) / sigma**2
        rest = np.mean((left - wide @ at) ** 2) if len(tau) else 0.0
        sigma = max(float(np.sqrt(rest)), floor)
    return float(_USUAL * at[-1]), float(_USUAL * np.sqrt(spread[-1, -1]))


def _shifted(recording: Recording, shift: float) -> Recording:
    if shift == 0:
        return recording
    t = recording.t
    moved = [np.interp(t + shift, t, column) for column in recording.tau.T]
    return replace(recording, tau=np.column_stack(moved))
