"""The residual of a fit, compared with the noise of torque and angles."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from residual.evidence.design import Design
from residual.evidence.fit import Fit
from residual.evidence.thresholds import THRESHOLDS
from residual.model.model import Model
from residual.recording import Array
from residual.signals.track import Track


@dataclass(frozen=True, eq=False, slots=True)
class Adequacy:
    """The unexplained torque of each joint, as a share of torque rms."""

    structured_share: Array  # root of (residual variance minus noise variance), (dof,)
    before: Array  # the same without the findings, (dof,)
    noise: Array  # noise level, (dof,)
    # Per joint "repeatable" or "time-driven"; None without repeats.
    kind: tuple[str | None, ...]
    # Joints (from 0) with too large a residual for any name.
    flagged: tuple[int, ...]
    # Joints with a residual above noise, including the flagged ones.
    doubted: tuple[int, ...]


def assess_adequacy(
    design: Design, tracks: tuple[Track, ...], before: Fit, after: Fit, angles: Array | None = None
) -> Adequacy:
    """Compare the residual on moving rows with the noise of torque and angles.

    The noise of the torque is measured above the identification filter and assumed to be
    white, that of the angles is given as the torque that it causes [N m]. A joint is
    flagged above 5 % of torque rms, unless the findings halved it, and above 10 % in any
    case. More than 1.5 % of torque rms and twice the noise is reported.
    """
    squares = np.mean([t.torque_noise**2 for t in tracks], axis=0)
    if angles is not None:
        squares = squares + angles**2
    noise = np.sqrt(squares) / design.rms
    structured = _structured(design, after, noise)
    first = _structured(design, before, noise)
    flagged = [
        j
        for j in range(design.dof)
        if (structured[j] > THRESHOLDS.flag_share and structured[j] > 0.5 * first[j])
        or structured[j] > 2 * THRESHOLDS.flag_share
    ]
    periods = [find_motion_period(track) for track in tracks]
    kinds = tuple(_residual_kind(design, periods, after, noise, j) for j in range(design.dof))
    least = np.maximum(THRESHOLDS.doubt_share, THRESHOLDS.doubt_noises * noise)
    doubted = sorted({*flagged, *np.flatnonzero(structured > least).tolist()})
    kinds = tuple(k if j in doubted else None for j, k in enumerate(kinds))
    return Adequacy(structured, first, noise, kinds, tuple(flagged), tuple(doubted))


def _structured(design: Design, fitted: Fit, noise: Array) -> Array:
    """Excess over the noise, beyond three standard deviations of a variance."""
    left = fitted.sse / design.rows / design.rms**2
    doubt = 1 + 3 * np.sqrt(2 / fitted.counted)
    return np.sqrt(np.maximum(left - noise**2 * doubt, 0))


def _residual_kind(
    design: Design, periods: list[int | None], fitted: Fit, noise: Array, j: int
) -> str | None:
    """Whether the residual of a periodic log repeats with the motion."""
    residuals = design.series(j, design.residual(j, fitted.ids, fitted.theta))
    same = other = count = 0.0
    for period, residual in zip(periods, residuals, strict=True):
        if period is None:
            continue
        a, b = residual[:-period], residual[period:]
        both = (a != 0) & (b != 0)
        same += float((a * b)[both].sum())
        other += float(((a - b) ** 2)[both].sum() / 2)
        count += float(both.sum())
    if not count:
        return None
    random = other / count - (noise[j] * design.rms[j]) ** 2
    return "repeatable" if same / count >= random else "time-driven"


def find_motion_period(track: Track) -> int | None:
    """Period of the motion in rows, from q itself; None if it does not repeat."""
    q = track.q[:: track.step]
    m = len(q)
    spread = np.maximum(q.std(axis=0), 1e-6)
    best, period = THRESHOLDS.repeat_share, None
    for lag in range(int(0.2 * m), int(0.8 * m)):
        gap = np.abs(q[lag:] - q[:-lag])[5:-5].mean(axis=0)
        worst = float(np.max(gap / spread)) if m - lag > 20 else np.inf
        if worst < best:
            best, period = worst, lag
    return period


def torque_from_angle_noise(
    model: Model, tracks: Sequence[Track], noisy_tracks: Sequence[Track]
) -> Array:
    """Torque noise of a model caused by noise of the angles, on moving rows.

    Effective variance (Orear 1982): the scatter about a model has the noise of the
    measured torque and that of the regressor.

    Args:
        noisy_tracks: The same, ``shaken``.

    Returns:
        Root mean square behind the identification filter [N m]. Shape (dof,).
    """
    squares, rows = np.zeros(model.robot.dof), np.zeros(model.robot.dof)
    for track, redrawn_track in zip(tracks, noisy_tracks, strict=True):
        torque = [model.torque_on(t) for t in (track, redrawn_track)]
        gap = track.filter(torque[1] - torque[0]) * track.moving
        squares += (gap**2).sum(axis=0)
        rows += track.moving.sum(axis=0)
    return np.sqrt(squares / np.maximum(rows, 1))
