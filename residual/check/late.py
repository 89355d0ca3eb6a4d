"""Torque that is smoothed at its source, or comes later than the angles."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.signal import welch

from residual.check.assignment import torque_scores
from residual.check.motion import thin_rows
from residual.check.result import DELAY, Fault
from residual.recording import Array, Recording
from residual.robot.robot import Robot

_SEGMENT = 128  # samples: short enough that most segments hold no reversal
# Shares of the sampling rate: noise of a sensor is as strong in both.
_NEAR, _HIGH = (0.12, 0.2), (0.35, 0.47)
_FALL = 20.0  # dB from one to the other: a filter of second order at least
_SILENT = 1e-4  # of the rms: below it no sensor's noise is
_NOTHING = 1e-16
_FIRST, _MORE = 0.02, (0.005, 0.01, 0.05, 0.1)  # s
_HINT, _WORTH = 4.0, 20.0  # nats


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
        f"The torque of joints {', '.join(map(str, joints))} has next to no noise "
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

    Args:
        robot: The arm.
        recordings: Its logs, whose columns are read rightly.
    """
    given = _evidence(robot, recordings, 0.0)
    tried = {s: _evidence(robot, recordings, s) - given for s in (_FIRST, -_FIRST)}
    sense = max(tried, key=tried.__getitem__)
    if tried[sense] < _HINT:
        return []
    for size in _MORE:
        shift = float(np.copysign(size, sense))
        tried[shift] = _evidence(robot, recordings, shift) - given
    best = max(tried, key=tried.__getitem__)
    if tried[best] < _WORTH:
        return []
    words = (
        f"The torque comes about {abs(1000 * best):.0f} ms "
        f"{'later' if best > 0 else 'earlier'} than the angles it belongs to; shifted "
        f"back it fits better by {tried[best]:.0f} nats."
    )
    return [Fault(DELAY, (), False, words)]


def _evidence(robot: Robot, recordings: Sequence[Recording], shift: float) -> float:
    motion = thin_rows([_shifted(r, shift) for r in recordings])
    if motion is None:
        return 0.0
    scores, one = torque_scores(robot, motion), np.ones(1)
    return sum(float(scores.evidence(j, j, one)[0]) for j in range(robot.dof))


def _shifted(recording: Recording, shift: float) -> Recording:
    if shift == 0:
        return recording
    t = recording.t
    moved = [np.interp(t + shift, t, column) for column in recording.tau.T]
    return replace(recording, tau=np.column_stack(moved))
