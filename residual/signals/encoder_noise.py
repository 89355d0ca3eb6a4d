"""The noise of the angles, as their own high frequencies show it."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from residual.recording import Array, Recording
from residual.signals.track import Filters, Track, motion_of, sample_rate

SEED = 0  # of the redrawn noise: a diagnosis says the same twice


def smooth(recording: Recording, filters: Filters) -> Array:
    """Positions through the filter of the kinematics, at the log's own times.

    Returns:
        Angles [rad]. Shape (n, dof).
    """
    t, _, (q, _, _) = motion_of(recording, filters)
    return np.column_stack([np.interp(recording.t, t, x) for x in q.T])


def encoder_noise(recording: Recording, filters: Filters) -> Array:
    """Level of the noise of the angles, from above the filter, taken as white [rad].

    By the median, so that jerks of the motion do not count. Shape (dof,).
    """
    _, q, (low, _, _) = motion_of(recording, filters)
    rate = sample_rate(recording.t)
    passed_on = min(filters.kinematics, 0.12 * rate) / (rate / 2)
    level = np.median(np.abs(q - low), axis=0) / 0.6745
    return level / np.sqrt(1 - passed_on)


def shaken(
    recordings: Sequence[Recording], tracks: Sequence[Track], filters: Filters
) -> tuple[Track, ...]:
    """The logs with one more helping of the noise of their angles.

    Args:
        tracks: The same, prepared: their rows and torque are kept.
    """
    rng, out = np.random.default_rng(SEED), []
    for r, track in zip(recordings, tracks, strict=True):
        noise = encoder_noise(r, filters) * rng.normal(size=r.q.shape)
        thin = round(sample_rate(r.t) / track.rate)
        *_, motion = motion_of(replace(r, q=r.q + noise), filters, thin)
        q, qd, qdd = motion
        out.append(replace(track, q=q, qd=qd, qdd=qdd))
    return tuple(out)


def on_rows_of(real: Sequence[Track], others: Sequence[Track]) -> tuple[Track, ...]:
    """Other angles in the place of the measured ones, on the very same rows."""
    return tuple(
        replace(t, tau=own.tau, inner=own.inner, moving=own.moving)
        for own, t in zip(real, others, strict=True)
    )
