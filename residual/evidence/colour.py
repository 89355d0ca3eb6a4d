"""Noise as it was measured: level and autocorrelation, and fresh draws of it."""

import numpy as np

from residual.evidence.design import LAGS, Design
from residual.evidence.fit import Fit
from residual.recording import Array

LONGEST = 2 * LAGS  # rows over which noise is believed to remember


def autocovariance(design: Design, fitted: Fit) -> Array:
    """Autocovariance of what a fit leaves, at the rows' rate [N^2 m^2]. (lags, dof).

    Masked rows are left out of sums and counts alike. A fit takes a part of the noise
    with it: as many effective rows as it has parameters that the joint decides. The
    longer half of the lags fades to nothing (a flat-top window, Politis & Romano 1995).
    """
    fade = np.clip(2 - 2 * np.arange(LONGEST) / LONGEST, 0, 1)
    taken = _taken(design, fitted)
    out = np.zeros((LONGEST, design.dof))
    for j in range(design.dof):
        left = design.residual(j, fitted.ids, fitted.theta)
        values, used = design.series(j, left), design.series(j, np.ones_like(left))
        pairs = np.maximum(sum(_products(x) for x in used), 1.0)
        kept = max(1 - taken[j] / fitted.counted[j], 0.5)
        out[:, j] = fade * sum(_products(x) for x in values) / pairs / kept
    return out


def coloured(acov: Array, rows: int, rng: np.random.Generator) -> Array:
    """Gaussian noise of a given autocovariance, by circulant embedding. (rows, dof).

    Args:
        acov: Autocovariance [N^2 m^2]. Shape (lags, dof).
    """
    lags, dof = acov.shape
    around = np.zeros((rows + 2 * lags, dof))
    around[:lags], around[-lags + 1 :] = acov, acov[:0:-1]
    # An estimate of a spectrum may fall below zero; what is cut off there is made up
    # for, so that the variance stays.
    spectrum = np.maximum(np.fft.rfft(around, axis=0).real, 0)
    variance = np.fft.irfft(spectrum, len(around), axis=0)[0]
    spectrum *= acov[0] / np.maximum(variance, 1e-300)
    white = np.fft.rfft(rng.normal(size=around.shape), axis=0)
    return np.fft.irfft(white * np.sqrt(spectrum), len(around), axis=0)[:rows]


def _products(line: Array) -> Array:
    """Sums of products of a line with itself, lag by lag. Shape (LONGEST,)."""
    spectrum = np.fft.rfft(line, 2 * len(line))
    sums = np.fft.irfft(spectrum * spectrum.conj())[: min(LONGEST, len(line))]
    return np.pad(sums, (0, LONGEST - len(sums)))


def _taken(design: Design, fitted: Fit) -> Array:
    """How many parameters each joint's rows decide (trace of the hat). (dof,)."""
    weight = fitted.weight(design.rows)
    covariance, out = fitted.covariance(), np.zeros(design.dof)
    for j in range(design.dof):
        place, have = design.present(j, fitted.ids)
        gram = design.total(j)[0][np.ix_(place, place)]
        out[j] = weight[j] * np.sum(gram * covariance[np.ix_(have, have)])
    return out
