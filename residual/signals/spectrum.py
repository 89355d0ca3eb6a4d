"""Power spectral density of signals, by averaged periodograms (Welch 1967).

Written out here since `scipy.signal`, with all that it brings, takes longer to import
than most logs take to be diagnosed.
"""

import numpy as np

from residual.recording import Array

_HARRIS = (0.35875, 0.48829, 0.14128, 0.01168)  # Blackman-Harris, four terms


def power_density(x: Array, length: int, robust: bool = False) -> tuple[Array, Array]:
    """Power per share of the sampling rate, of segments that overlap by half.

    Args:
        x: Signals. Shape (n, k), n at least the length.
        length: Samples of a segment; its mean is taken out.
        robust: Take the median of the segments instead of their mean.

    Returns:
        Frequencies as shares of the sampling rate, and densities [x^2]. Shapes (f,),
        (f, k).
    """
    turn = 2 * np.pi * np.arange(length) / length
    terms = (a * (-1) ** i * np.cos(i * turn) for i, a in enumerate(_HARRIS))
    window = np.sum(list(terms), axis=0)
    parts = np.lib.stride_tricks.sliding_window_view(x, length, axis=0)
    parts = parts[:: max(length // 2, 1)]
    parts = (parts - parts.mean(axis=-1, keepdims=True)) * window
    power = np.abs(np.fft.rfft(parts)) ** 2 / (window**2).sum()
    # The median of a squared normal is short of its mean by the logarithm of 2.
    middle = np.median(power, axis=0) / np.log(2) if robust else power.mean(axis=0)
    return np.fft.rfftfreq(length), 2 * middle.T
