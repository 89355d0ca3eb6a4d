"""What is usual of the errors of a robot in good order, and all scores against that."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from residual.monitoring.cycle import before, repeats
from residual.monitoring.scores import (
    Scale,
    Scores,
    error_block,
    error_scores,
    fast_scores,
    matched_scores,
)
from residual.monitoring.sight import Sight
from residual.recording import Array, Recording

_EXPLAINED = 0.8  # share of the errors' variance that components are kept for
_TINY = 1e-9


@dataclass(frozen=True, eq=False, slots=True)
class Rest:
    """What a model leaves of the torque of a log.

    Attributes:
        tau: Torque that is expected [N m]. Shape (m, dof).
        residual: Measured minus expected [N m]. Shape (m, dof).
        change: The same minus that of a cycle ago, or None. Shape (m, dof).
        usable: Where there is a cycle before, or None. Shape (m,), bool.
    """

    tau: Array
    residual: Array
    change: Array | None = None
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
        logs: Good logs.
        rests: What is left of their torque, by coefficients that did not see them.
        without: Index of the log to leave out, -1 for none.
    """
    pairs = [p for i, p in enumerate(zip(logs, rests, strict=True)) if i != without]
    residual = _rms([(r.residual, log.slow, log.rows.whole) for log, r in pairs])
    cyclic = [(r.change, log.slow, r.usable) for log, r in pairs if log.period]
    change = _rms(cyclic) if cyclic else np.sqrt(2.0) * residual
    errors = np.vstack(
        [error_block(r.residual, log.rows)[log.rows.whole] for log, r in pairs]
    )
    mean, size = errors.mean(axis=0), np.maximum(errors.std(axis=0), _TINY)
    _, s, vt = np.linalg.svd((errors - mean) / size, full_matrices=False)
    share = np.cumsum(s**2) / max(float(np.sum(s**2)), _TINY)
    keep = int(np.searchsorted(share, _EXPLAINED)) + 1
    variance = np.maximum(s[:keep] ** 2 / len(errors), _TINY)
    return Scale(residual, change, mean, size, vt[:keep].T, variance)


def all_scores(recording: Recording, log: Sight, theta: Array, scale: Scale):
    """Score a log.

    Args:
        recording: The log.
        log: What is known of it.
        theta: Coefficients of the model. Shape (p,).
        scale: What is usual.

    Returns:
        All scores, and the block of errors, shape (m, e).
    """
    rest, whole = rest_of(log, theta), log.rows.whole
    scores: list[Scores] = list(fast_scores(recording))
    scores.append(
        matched_scores("model", rest.residual, rest.tau, log, scale.residual, whole)
    )
    if rest.change is not None:
        scores.append(
            matched_scores(
                "cycle", rest.change, rest.tau, log, scale.change, rest.usable
            )
        )
    errors = error_block(rest.residual, log.rows)
    scores.append(error_scores(errors, log.rows, scale))
    return scores, errors


def _rms(parts: Sequence[tuple[Array, Array, Array]]) -> Array:
    """Root mean square of values, moving and slow, on usable rows. Shape (2, dof)."""
    x, slow = (np.vstack([part[k] for part in parts]) for k in (0, 1))
    use = np.concatenate([usable for _, _, usable in parts])[:, None]
    rms = []
    for chosen in (~slow & use, slow & use):
        count = np.maximum(chosen.sum(axis=0), 1)
        rms.append(np.sqrt((x**2 * chosen).sum(axis=0) / count))
    moving = np.maximum(rms[0], 1e-3 * max(float(rms[0].max()), _TINY))
    # Standing tells less than moving, never more.
    return np.array([moving, np.maximum(rms[1], moving)])
