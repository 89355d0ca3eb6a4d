"""Logs with a fault taken out, so that the next check does not trip over it."""

from dataclasses import replace

import numpy as np
from scipy.ndimage import median_filter

from residual.recording import Recording

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
    smooth = {
        name: median_filter(signal, (_WINDOW, 1), mode="nearest")
        for name, signal in signals.items()
        if signal is not None
    }
    return replace(recording, **smooth)
