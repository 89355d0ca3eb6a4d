"""The zero-phase low-pass, computed at every k-th sample as one product.

Implemented here since importing `scipy.signal` with its dependencies takes longer than
diagnosing most logs.
"""

from functools import cache

import numpy as np

from residual.recording import Array

CUTOFF = 8.0  # Hz, of the identification filter; lower for slow logs
ORDER = 4  # of the Butterworth filter, which runs forwards and backwards
REACH = 4.5  # periods of the cut-off after which the response has decayed to 1e-5
BLOCK = 16  # rows computed at once


def filter_low_pass(x: Array, cutoff: float, rate: float, step: int = 1, order: int = 0) -> Array:
    """Butterworth low-pass of order 4, forwards and backwards, along the first axis.

    Computed as a product with the filter's impulse response, so dropped samples cost
    nothing. Beyond its ends the signal is extended by point reflection.

    Args:
        x: Signals. Shape (n, ...).
        cutoff: Cut-off of the low-pass [Hz].
        rate: Sample rate of the signals [Hz].
        step: Returned samples: 0, step, 2 step, ...
        order: Order of the time derivative, by central differences; above 0 the cut-off
            must be well below half of the rate.

    Returns:
        Shape (ceil(n / step), ...).
    """
    x = np.asarray(x, dtype=float)
    if cutoff >= 0.45 * rate:
        return x[::step]
    band, reach = _band(cutoff, rate, step, order)
    rows = -(-len(x) // step)
    blocks = -(-rows // BLOCK)
    flat = x.reshape(len(x), -1).T  # time last: each signal is contiguous
    longer = _with_ends(flat, reach, (blocks - 1) * BLOCK * step + len(band))
    out = np.empty((len(flat), blocks * BLOCK))
    for b in range(blocks):
        first, row = b * BLOCK * step, b * BLOCK
        out[:, row : row + BLOCK] = longer[:, first : first + len(band)] @ band
    return out[:, :rows].T.reshape(rows, *x.shape[1:])


def _with_ends(x: Array, reach: int, length: int) -> Array:
    """The signal from ``reach`` before its start, up to a length."""
    n = x.shape[1]
    ends, first, last = min(reach, n - 1), x[:, :1], x[:, -1:]
    out = np.empty((len(x), length))
    out[:, reach : reach + n] = x
    out[:, reach - ends : reach] = 2 * first - x[:, ends:0:-1]
    out[:, : reach - ends] = out[:, [reach - ends]]
    stop = min(reach + n + ends, length)
    after = x[:, n - 1 - (stop - reach - n) : n - 1]
    out[:, reach + n : stop] = 2 * last - after[:, ::-1]
    out[:, stop:] = out[:, [stop - 1]]
    return out


@cache
def _band(cutoff: float, rate: float, step: int, order: int) -> tuple[Array, int]:
    """Return the matrix from samples to a block of rows, and its reach.

    The filter is |H|^2 = 1 / (1 + (tan(w / 2) / tan(w_c / 2))^(2 N)), w in rad/sample,
    by the bilinear transform; its impulse response is taken from -reach to reach.
    """
    reach = int(np.ceil(REACH / cutoff * rate))
    half = np.linspace(0, np.pi / 2, 4 * reach + 1)[:-1]  # at pi it is zero
    warped = np.tan(half) / np.tan(np.pi * min(cutoff / rate, 0.49))
    pulse = np.fft.irfft(np.append(1 / (1 + warped ** (2 * ORDER)), 0.0))
    taps = np.concatenate([pulse[-reach:], pulse[: reach + 1]])
    taps = taps / taps.sum()
    for _ in range(order):  # d/dt of the output: the response differenced, turned
        taps = np.convolve(taps, [-rate / 2, 0.0, rate / 2])
    reach += order
    band = np.zeros(((BLOCK - 1) * step + len(taps), BLOCK))
    for row in range(BLOCK):
        band[row * step : row * step + len(taps), row] = taps
    return band, reach


def randomise_phases(spectrum: Array, rows: int, rng: np.random.Generator) -> Array:
    """Return signals of given one-sided spectra with independent random phases.

    Mean and amplitude at every frequency are kept. (rows // 2 + 1, k) to (rows, k).
    """
    turn = np.exp(2j * np.pi * rng.random(spectrum.shape))
    # Mean and, for an even length, the highest frequency must stay real.
    turn[0] = 1
    if rows % 2 == 0:
        turn[-1] = np.sign(turn[-1].real)
    return np.fft.irfft(spectrum * turn, n=rows, axis=0)
