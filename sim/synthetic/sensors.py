"""What the sensors make of the true values."""

import numpy as np
from scipy.signal import lfilter

Array = np.ndarray

ENCODER_STEP = 1e-4  # rad
WHITE_TORQUE = 0.015  # of the torque range
SLOW_TORQUE = 0.005  # of the torque range
SLOW_TIME = 0.1  # s


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
        samples: Number of samples n.
        span: Range of the torque of each joint [N m]. Shape (dof,).
        rate: Samples per second [Hz].
        rng: Random stream.

    Returns:
        Noise [N m]. Shape (n, dof).
    """
    a = np.exp(-1.0 / (SLOW_TIME * rate))
    white, drive = rng.normal(size=(2, samples, len(span)))
    before = a * rng.normal(size=(1, len(span)))
    slow, _ = lfilter([np.sqrt(1 - a * a)], [1, -a], drive, axis=0, zi=before)
    return span * (WHITE_TORQUE * white + SLOW_TORQUE * slow)
