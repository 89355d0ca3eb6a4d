"""What is usual on a healthy robot: scores against that, and their limits.

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
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import stdtrit

from residual.monitoring.rows import before, repeats
from residual.monitoring.rules import MONITOR
from residual.monitoring.scores import (
    Scale,
    Scores,
    Sight,
    error_block,
    error_scores,
    fast_scores,
    matched_scores,
)
from residual.recording import Array, Recording

_TINY = 1e-9


@dataclass(frozen=True, eq=False, slots=True)
class Rest:
    """What a model leaves of the torque of a log."""

    tau: Array  # torque that is expected [N m], (m, dof)
    residual: Array  # measured minus expected [N m], (m, dof)
    change: Array | None = None  # the same minus that of a cycle ago, or None, (m, dof)
    # Where there is a cycle before, or None. Shape (m,), bool.
    usable: Array | None = None


def rest_of(log: Sight, theta: Array) -> Rest:
    """Return what coefficients leave of the torque of a log."""
    tau = log.torque(theta)
    residual = log.rows.tau - tau
    if log.period is None:
        return Rest(tau, residual)
    change = residual - before(residual, log.rows, log.period)
    return Rest(tau, residual, change, repeats(log.rows, log.period))


def usual(logs: Sequence[Sight], rests: Sequence[Rest], without: int = -1) -> Scale:
    """Return what is usual of errors in all logs but one.

    Args:
        rests: What is left of their torque, by coefficients that did not see them.
    """
    pairs = [p for i, p in enumerate(zip(logs, rests, strict=True)) if i != without]
    residual = _rms([(r.residual, log.slow, log.rows.inner) for log, r in pairs])
    cyclic = [(r.change, log.slow, r.usable) for log, r in pairs if log.period]
    change = _rms(cyclic) if cyclic else np.sqrt(2.0) * residual
    errors = np.vstack(
        [error_block(r.residual, log.rows)[log.rows.inner] for log, r in pairs]
    )
    mean, size = errors.mean(axis=0), np.maximum(errors.std(axis=0), _TINY)
    _, s, vt = np.linalg.svd((errors - mean) / size, full_matrices=False)
    share = np.cumsum(s**2) / max(float(np.sum(s**2)), _TINY)
    keep = int(np.searchsorted(share, MONITOR.explained)) + 1
    variance = np.maximum(s[:keep] ** 2 / len(errors), _TINY)
    return Scale(residual, change, mean, size, vt[:keep].T, variance)


def all_scores(recording: Recording, log: Sight, theta: Array, scale: Scale):
    """Return all scores of a log, and the block of its errors. Shape (m, e)."""
    rest = rest_of(log, theta)
    looks = [("model", rest.residual, scale.residual, log.rows.inner)]
    if rest.change is not None:
        looks.append(("cycle", rest.change, scale.change, rest.usable))
    errors = error_block(rest.residual, log.rows)
    matched = [
        matched_scores(kind, left, rest.tau, log, size, usable)
        for kind, left, size, usable in looks
    ]
    fast, slow = fast_scores(recording), error_scores(errors, log.rows, scale)
    return [*fast, *matched, slow], errors


def _rms(parts: Sequence[tuple[Array, Array, Array]]) -> Array:
    """Root mean square of values, moving and slow, on usable rows. Shape (2, dof)."""
    x, slow = (np.vstack([part[k] for part in parts]) for k in (0, 1))
    use = np.concatenate([usable for _, _, usable in parts])[:, None]
    moving, standing = (
        np.sqrt((x**2 * own).sum(axis=0) / np.maximum(own.sum(axis=0), 1))
        for own in (~slow & use, slow & use)
    )
    moving = np.maximum(moving, 1e-3 * max(float(moving.max()), _TINY))
    # Standing tells less than moving, never more.
    return np.array([moving, np.maximum(standing, moving)])


BLOCK = 2.0  # s


def limits_of(runs: Sequence[Scores], per_hour: float) -> Array:
    """Return limits of one kind of scores, from logs that did not set its scale.

    Columns are brought to one size first, by the level that a twentieth of their
    blocks exceeds; the tail is that of the largest of all columns, since they are
    anything but independent.

    Args:
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
    """Return what a block exceeds with the wanted probability at most. Shape (b,)."""
    least = MONITOR.margin * float(peaks.max())
    threshold = float(np.quantile(peaks, 1.0 - MONITOR.tail))
    above = peaks[peaks > threshold] - threshold
    if len(above) == 0:
        return least
    beta = float(above.mean()) * (1.0 + MONITOR.sure / np.sqrt(len(above)))
    share = len(above) / len(peaks)
    further = beta * max(0.0, float(np.log(share / wanted)))
    return max(threshold + further, least)


def next_run_limit(largest: Array, wanted: float) -> float:
    """Return what the next run exceeds with the wanted probability at most. (runs,)."""
    if len(largest) < 2 or largest.min() <= 0:
        return 0.0
    logs, n = np.log(largest), len(largest)
    sure = float(stdtrit(n - 1, 1.0 - min(wanted, 0.5)))  # of Student's t
    return float(np.exp(logs.mean() + sure * logs.std(ddof=1) * np.sqrt(1 + 1 / n)))


def peaks_of(scores: Scores) -> Scores:
    """Return the maxima of blocks alone: all that limits are made of.

    Its times are those of the first rows of the blocks, and of the last row of all.
    """
    first, last = _blocks(scores), len(scores.t) - 1
    values = block_maxima(scores)
    if first[-1] != last:
        # No score is below 0: this row says no more than how long the log is.
        values = np.vstack([values, np.zeros((1, values.shape[1]))])
        first = np.append(first, last)
    return replace(scores, t=scores.t[first], values=values)


def block_maxima(scores: Scores) -> Array:
    """Return the largest value of each block of time. Shape (blocks, c)."""
    return np.maximum.reduceat(scores.values, _blocks(scores), axis=0)


def _blocks(scores: Scores) -> Array:
    """First row of each block of time. Shape (blocks,)."""
    block = ((scores.t - scores.t[0]) // BLOCK).astype(int)
    return np.flatnonzero(np.diff(block, prepend=-1))
