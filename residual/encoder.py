"""The noise of the angles, as their own high frequencies show it."""

import numpy as np

from residual.model import at_samples
from residual.recording import Array, Recording
from residual.signals import Filters, prepare, sample_rate


def smooth(recording: Recording, filters: Filters) -> Array:
    """Positions through the filter of the kinematics, at the log's own times.

    Args:
        recording: A log of n samples.
        filters: The signal path.

    Returns:
        Angles [rad]. Shape (n, dof).
    """
    (track,), _ = prepare([recording], filters, full_rate=True)
    return at_samples(track.q, track, recording)


def encoder_noise(recording: Recording, filters: Filters) -> Array:
    """Level of the noise of the angles, from above the filter, taken as white [rad].

    By the median, so that jerks of the motion do not count. Shape (dof,).
    """
    rate = sample_rate(recording.t)
    high = recording.q - smooth(recording, filters)
    passed_on = min(filters.kinematics, 0.12 * rate) / (rate / 2)
    level = np.median(np.abs(high), axis=0) / 0.6745
    return level / np.sqrt(1 - passed_on)
