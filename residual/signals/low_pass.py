"""The zero-phase low-pass, and the same where only every k-th value is asked for."""

from functools import cache

import numpy as np
from scipy.signal import butter, sosfiltfilt

from residual.recording import Array

REACH = 6.0  # periods of the cut-off after which it has forgotten all but 1e-6
BLOCK = 32  # rows that are made at once


def low_pass(x: Array, cutoff: float, rate: float) -> Array:
    """Zero-phase Butterworth low-pass of order 4 (twice 4) along the first axis."""
    if cutoff >= 0.45 * rate:
        return np.asarray(x, dtype=float)
    return sosfiltfilt(
        _butterworth(cutoff / (rate / 2)), x, axis=0, padlen=min(len(x) - 2, int(rate))
    )


@cache
def _butterworth(share: float) -> Array:
    """Second-order sections of the low-pass; its design costs more than its use."""
    return butter(4, share, output="sos")


def decimated(x: Array, cutoff: float, rate: float, step: int) -> Array:
    """Every ``step``-th value of ``low_pass``, right but for the ends.

    As a product with the filter's own impulse response, cut off where it has died away:
    a tenth of the work. At the ends, where it reaches beyond the signal, values are of
    no use.

    Args:
        x: Signals. Shape (n, ...).
        cutoff: Of the low-pass [Hz].
        rate: Of the signals [Hz].
        step: Which values.

    Returns:
        Values at 0, step, 2 step, ... Shape (ceil(n / step), ...).
    """
    if cutoff >= 0.45 * rate:
        return np.asarray(x, dtype=float)[::step]
    band, reach = _band(cutoff, rate, step)
    rows = -(-len(x) // step)
    blocks = -(-rows // BLOCK)
    flat = np.asarray(x, dtype=float).reshape(len(x), -1)
    span = band.shape[1]
    padded = np.zeros(((blocks - 1) * BLOCK * step + span, flat.shape[1]))
    padded[reach : reach + len(flat)] = flat
    out = np.empty((blocks * BLOCK, flat.shape[1]))
    for b in range(blocks):
        first = b * BLOCK * step
        np.matmul(
            band,
            padded[first : first + span],
            out=out[b * BLOCK : (b + 1) * BLOCK],
        )
    return out[:rows].reshape(rows, *np.shape(x)[1:])


@cache
def _band(cutoff: float, rate: float, step: int) -> tuple[Array, int]:
    """What makes a block of rows of the samples around it, and how far it reaches."""
    reach = int(np.ceil(REACH / cutoff * rate))
    pulse = np.zeros(8 * reach + 1)
    pulse[4 * reach] = 1.0
    taps = low_pass(pulse, cutoff, rate)[3 * reach : 5 * reach + 1]
    band = np.zeros((BLOCK, (BLOCK - 1) * step + 2 * reach + 1))
    for row in range(BLOCK):
        band[row, row * step : row * step + len(taps)] = taps
    return band, reach
