"""What the sensors make of the true values."""

from collections.abc import Sequence

import numpy as np
from scipy.signal import lfilter

from sim.catalogue import Acting

Array = np.ndarray

ENCODER_STEP = 1e-4  # rad
WHITE_TORQUE = 0.015  # of the torque range
SLOW_TORQUE = 0.005  # of the torque range
SLOW_TIME = 0.1  # s
SLACK = 1e-9  # s: an onset on a sample acts on that sample


def encoder(q: Array, rng: np.random.Generator, step: float = ENCODER_STEP) -> Array:
    """Return positions with noise of half a step, rounded to whole steps [rad]."""
    noisy = q + step / 2 * rng.normal(size=q.shape)
    return np.round(noisy / step) * step


def torque_noise(
    samples: int, span: Array, rate: float, rng: np.random.Generator
) -> Array:
    """Return the noise of the torque sensors: white, and a slow AR(1) process.

    n_i = span (0.015 w_i + 0.005 x_i), x_i = a x_(i-1) + sqrt(1 - a^2) v_i,
    a = exp(-1 / (0.1 s rate))

    Args:
        span: Range of the torque of each joint [N m]. Shape (dof,).
        rate: Samples per second [Hz].

    Returns:
        Noise [N m]. Shape (n, dof).
    """
    a = np.exp(-1.0 / (SLOW_TIME * rate))
    white, drive = rng.normal(size=(2, samples, len(span)))
    before = a * rng.normal(size=(1, len(span)))
    slow, _ = lfilter([np.sqrt(1 - a * a)], [1, -a], drive, axis=0, zi=before)
    return span * (WHITE_TORQUE * white + SLOW_TORQUE * slow)


def reported(tau: Array, t: Array, effects: Sequence[Acting]) -> Array:
    """Return the torque as it is reported, noise apart [N m]. Shape (n, dof).

    The drive itself works; its report ends at the range of its sensor, then it comes
    late, then the sensor is broken.

    Args:
        tau: Torque that the drives believe to give [N m]. Shape (n, dof).
        t: Times since the motion began [s]. Shape (n,).
        effects: All effects; each acts from its onset on.
    """
    out = tau.copy()
    for what, p, joints, onset in sorted(effects, key=lambda e: e.what.stage):
        if what.report:
            rows = list(joints) or list(range(out.shape[1]))
            acts = np.ix_(t >= onset - SLACK, rows)
            out[acts] = what.report(out[:, rows], t, onset, p)[acts[0][:, 0]]
    return out
