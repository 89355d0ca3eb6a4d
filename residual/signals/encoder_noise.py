"""The noise of the angles, as their own high frequencies show it."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from residual.recording import Array, Recording
from residual.signals.track import Filters, Track, at_samples, prepare, sample_rate

SEED = 0  # of the redrawn noise: a diagnosis says the same twice


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


def shaken(
    recordings: Sequence[Recording],
    tracks: Sequence[Track],
    filters: Filters,
    speed_floor: Array,
) -> tuple[Track, ...]:
    """The logs with one more helping of the noise of their angles.

    Args:
        recordings: The logs.
        tracks: The same, prepared: their rows and torque are kept.
        filters: The signal path.
        speed_floor: Standstill thresholds [rad/s]. Shape (dof,).
    """
    rng, noisier = np.random.default_rng(SEED), []
    for r in recordings:
        noise = encoder_noise(r, filters) * rng.normal(size=r.q.shape)
        noisier.append(replace(r, q=r.q + noise, qd=None, qdd=None))
    return on_rows_of(tracks, prepare(noisier, filters, speed_floor)[0])


def on_rows_of(real: Sequence[Track], others: Sequence[Track]) -> tuple[Track, ...]:
    """Other angles in the place of the measured ones, on the very same rows."""
    return tuple(
        replace(t, tau=own.tau, inner=own.inner, moving=own.moving)
        for own, t in zip(real, others, strict=True)
    )
