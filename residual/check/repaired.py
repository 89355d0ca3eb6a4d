"""Logs with a fault taken out, so that the next check does not trip over it."""

from dataclasses import replace

import numpy as np
from scipy.ndimage import median_filter

from residual.recording import Array, Recording

_WINDOW = 7


def with_scale(recording: Recording, signal: str, scale: float) -> Recording:
    """Return a log with one of its signals times a factor.

    Args:
        recording: The log.
        signal: "t", "q", "qd", "tau" or "q_ref".
        scale: The factor.
    """
    return replace(
        recording, **{signal: np.asarray(getattr(recording, signal)) * scale}
    )


def without_spikes(recording: Recording) -> Recording:
    """Return a log smoothed by a running median, which no single sample survives.

    Args:
        recording: The log.
    """
    names = ("q", "qd", "tau")
    signals = {name: getattr(recording, name) for name in names}
    smooth = {k: running_median(x) for k, x in signals.items() if x is not None}
    return replace(recording, **smooth)


def running_median(x: Array) -> Array:
    """Return the median over each sample and its neighbours.

    Args:
        x: Samples along the first axis. Shape (n,) or (n, dof).
    """
    window = (_WINDOW,) + (1,) * (x.ndim - 1)
    return median_filter(x, window, mode="nearest")
