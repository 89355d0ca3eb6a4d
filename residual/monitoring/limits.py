"""Limits for scores: from the largest values of blocks, so that few alarms are false.

Neighbouring values of a score are nearly the same, so values cannot be counted as if
they were independent. Blocks of some seconds nearly are. Over a high threshold u the
maxima of blocks decay about exponentially (peaks over threshold: Davison & Smith 1990):

P(M > u + x) = share exp(-x / beta),   limit = u + beta log(share / wanted)

beta is taken at the upper end of its confidence, and no limit is below 1.5 times the
largest value that good runs showed. Blocks of one run are alike in what the run is
like. So no limit is below what the largest value of the next run may be either, from
the spread of the runs, by Student's t:

log limit = mean log M + t(1 - wanted, n - 1) s sqrt(1 + 1 / n)

Few runs have a large t, and make wide limits.
"""

from collections.abc import Sequence

import numpy as np
from scipy.stats import t as student

from residual.monitoring.scores import Scores
from residual.recording import Array

BLOCK = 2.0  # s
_SHARE = 0.2  # of the blocks are over the threshold
_SURE = 1.645  # one-sided 95 % of a normal variable
_MARGIN = 1.5


def limits_of(runs: Sequence[Scores], per_hour: float) -> Array:
    """Return limits of one kind of scores, from logs that did not set its scale.

    Columns are brought to one size first, by the level that a twentieth of their
    blocks exceeds; the tail is that of the largest of all columns, since they are
    anything but independent.

    Args:
        runs: Scores of good runs, of one kind.
        per_hour: False alarms of this kind that are wanted at most, per hour.

    Returns:
        Limit of each column, infinite where a score never left 0. Shape (c,).
    """
    each = [block_maxima(run) for run in runs]
    peaks = np.vstack(each)
    level = np.quantile(peaks, 0.95, axis=0)
    usual = np.maximum(level, 1e-6 * max(level.max(), 1e-9))
    largest = [(own / usual).max(axis=1) for own in each]
    hours = np.mean([run.t[-1] - run.t[0] for run in runs]) / 3600.0
    factor = max(
        tail_limit(np.concatenate(largest), per_hour * BLOCK / 3600.0),
        next_run_limit(np.array([own.max() for own in largest]), per_hour * hours),
    )
    return np.where(peaks.max(axis=0) > 0, usual * factor, np.inf)


def tail_limit(peaks: Array, wanted: float) -> float:
    """Return the value that a block exceeds with the wanted probability at most.

    Args:
        peaks: Maxima of blocks. Shape (b,).
        wanted: Probability.
    """
    least = _MARGIN * float(peaks.max())
    threshold = float(np.quantile(peaks, 1.0 - _SHARE))
    above = peaks[peaks > threshold] - threshold
    if len(above) == 0:
        return least
    beta = float(above.mean()) * (1.0 + _SURE / np.sqrt(len(above)))
    share = len(above) / len(peaks)
    return max(threshold + beta * max(0.0, float(np.log(share / wanted))), least)


def next_run_limit(largest: Array, wanted: float) -> float:
    """Return the value that the next run exceeds with the wanted probability at most.

    Args:
        largest: Largest value of each run. Shape (runs,).
        wanted: Probability.
    """
    if len(largest) < 2 or largest.min() <= 0:
        return 0.0
    logs, n = np.log(largest), len(largest)
    sure = float(student.ppf(1.0 - min(wanted, 0.5), n - 1))
    return float(np.exp(logs.mean() + sure * logs.std(ddof=1) * np.sqrt(1 + 1 / n)))


def block_maxima(scores: Scores) -> Array:
    """Return the largest value of each block of time. Shape (blocks, c)."""
    block = ((scores.t - scores.t[0]) // BLOCK).astype(int)
    first = np.flatnonzero(np.diff(block, prepend=-1))
    return np.maximum.reduceat(scores.values, first, axis=0)
