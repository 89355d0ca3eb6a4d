"""Torques too small to say anything of: little more than their step, or their noise."""

from collections.abc import Sequence

import numpy as np

from residual.recording import Array, Recording
from residual.signals.track import Track

STEPS = 5.0  # of its sensor's step that the rms of a torque must be
NOISES = 2.0  # of its noise behind the filter, where the joint moves


def too_small(recordings: Sequence[Recording], tracks: Sequence[Track]) -> Array:
    """Return which joints' torque is but its quantisation or noise. (dof,), bool.

    A torque of that size has no error in per cent: a model that says nothing of it is
    as good as any.

    Args:
        recordings: The logs.
        tracks: Their signals, in the same order.
    """
    tau = np.concatenate([r.tau for r in recordings])
    rms = np.sqrt((tau**2).mean(axis=0))
    steps = np.array([_step(column) for column in tau.T])
    coarse = (rms > 0) & (rms < STEPS * steps)
    power = sum(((t.tau * t.moving) ** 2).sum(axis=0) for t in tracks)
    rows = sum(t.moving.sum(axis=0) for t in tracks)
    noise = np.mean([t.torque_noise**2 for t in tracks], axis=0)
    return coarse | ((rows > 0) & (power < NOISES**2 * noise * rows))


def _step(values: Array) -> float:
    """Least difference of two values; 0 where they are too many for steps."""
    levels = np.unique(values)
    if not 1 < len(levels) < len(values) / 10:
        return 0.0
    return float(np.diff(levels).min())
