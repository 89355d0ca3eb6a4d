"""How many principal components are more than chance (parallel analysis).

Horn, J. L. (1965), Psychometrika 30, compares with white noise. Rows of a log are
autocorrelated: two slow signals of no relation correlate by chance. So chance is drawn
with the spectrum of every variable kept (phase randomisation: Theiler et al. 1992,
Physica D 58); the count from permuted rows stands beside it.
"""

from dataclasses import dataclass

import numpy as np

from residual.errors import InputError
from residual.recording import Array
from residual.tables.blocks import (
    as_block,
    as_names,
    check_count,
    check_varying,
    frozen,
)

LEAST_DRAWS = 20  # a 95 % limit from fewer is their maximum


@dataclass(frozen=True, eq=False, slots=True)
class RealComponents:
    """Numbers of components that stand out of chance.

    Attributes:
        count: Against phase-randomised surrogates: the number to use.
        permuted: Against permuted rows, which forget that rows are autocorrelated.
        phase_limit: Quantile of the surrogates' eigenvalues. Shape (k,).
    """

    count: int
    permuted: int
    phase_limit: Array


def real_components(
    X: Array,
    rng: np.random.Generator,
    *,
    run: Array | None = None,
    draws: int = 100,
    quantile: float = 0.95,
) -> RealComponents:
    """Count the leading components with more variance than chance gives.

    A component counts if its eigenvalue, and those of all before it, exceed the
    quantile of the same eigenvalue over the surrogates.

    Args:
        X: Signals as columns. Shape (n, k).
        run: Run of each row: surrogates are drawn within runs. Shape (n,); one if None.
        quantile: Share of the surrogates that chance may not exceed.

    Raises:
        InputError: On a constant column, a value that is not finite, too few draws,
            or a run of fewer than 4 rows.
    """
    X = as_block(X, "X")
    check_varying(X, as_names(None, X.shape[1], "x"))
    check_count(draws, LEAST_DRAWS, 10**6, "draws", "100 are usual.")
    parts = _parts(len(X), run)
    own = _eigenvalues(X)
    spectra = [np.fft.rfft(X[rows] - X[rows].mean(0), axis=0) for rows in parts]
    means = np.concatenate([np.repeat(X[r].mean(0)[None], len(r), 0) for r in parts])
    order = np.concatenate(parts)
    phase, permuted = np.empty((2, draws, X.shape[1]))
    for i in range(draws):
        pairs = zip(spectra, parts, strict=True)
        new = [randomise_phases(s, len(rows), rng) for s, rows in pairs]
        phase[i] = _eigenvalues(np.concatenate(new) + means)
        permuted[i] = _eigenvalues(rng.permuted(X[order], axis=0))
    limits = [np.quantile(p, quantile, axis=0) for p in (phase, permuted)]
    counts = [_leading(own, limit) for limit in limits]
    return RealComponents(*counts, frozen(limits[0]))


def randomise_phases(spectrum: Array, rows: int, rng: np.random.Generator) -> Array:
    """Return signals of the same amplitude spectra with independent random phases.

    Args:
        spectrum: One-sided transform of each column (`numpy.fft.rfft`).
            Shape (rows // 2 + 1, k).

    Returns:
        Signals; mean and amplitude at every frequency are kept. Shape (rows, k).
    """
    turn = np.exp(2j * np.pi * rng.random(spectrum.shape))
    # Mean and, for an even length, the highest frequency must stay real.
    turn[0] = 1
    if rows % 2 == 0:
        turn[-1] = np.sign(turn[-1].real)
    return np.fft.irfft(spectrum * turn, n=rows, axis=0)


def _parts(rows: int, run: Array | None) -> list[Array]:
    run = np.zeros(rows, int) if run is None else np.asarray(run)
    if run.shape != (rows,):
        raise InputError(f"run has shape {run.shape}, expected ({rows},).")
    parts = [np.flatnonzero(run == label) for label in np.unique(run)]
    shortest = min(map(len, parts))
    check_count(shortest, 4, rows, "rows of a run", "Leave short runs out.")
    return parts


def _eigenvalues(X: Array) -> Array:
    return np.linalg.eigvalsh(np.corrcoef(X.T).reshape(X.shape[1], -1))[::-1]


def _leading(values: Array, limit: Array) -> int:
    # In a correlation matrix a first component too large makes the others small, so
    # only an unbroken start is a count.
    beyond = values > limit
    return int(len(beyond) if beyond.all() else np.argmin(beyond))
