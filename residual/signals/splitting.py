"""Splitting of long logs into pieces, and of the last quarter.

A log of an hour would take gigabytes: the regressor of its motion alone has 360 numbers a
row. A fit needs only sums over rows, which can be computed piece by piece. Pieces overlap
by the part dropped at their ends, which exceeds the memory of the filter: the rows of the
pieces are those of the full log. They keep the id of their log.
"""

import mmap
from collections.abc import Sequence
from dataclasses import fields, replace
from itertools import groupby, pairwise

import numpy as np

from residual.recording import Recording
from residual.signals.filters import CUTOFF

LONG = 600.0  # s, total length from which logs are cut
MANY = 300_000  # samples likewise: memory is proportional to them
PIECE = 60.0  # s
FORGETS = 8.0  # periods of the identification filter dropped at the ends
SKETCH = 420.0  # s of long logs kept in memory, for quantities that are not sums
# So that no piece spans two folds of a log (evidence/design.py).
_MULTIPLE = 6


def split_long_logs(
    recordings: Sequence[Recording], cutoff: float = CUTOFF
) -> tuple[Recording, ...]:
    """Cut long logs.

    Returns:
        The logs, or in place of each of two minutes or more its pieces, in order.
    """
    if not exceed_split_length(recordings):
        return tuple(recordings)
    return tuple(piece for r in recordings for piece in _pieces(r, cutoff))


def exceed_split_length(recordings: Sequence[Recording]) -> bool:
    """Whether logs are more than ten minutes, or 300 000 samples, in all."""
    samples = sum(len(r.t) for r in recordings)
    return samples > MANY or sum(r.duration for r in recordings) > LONG


def _pieces(recording: Recording, cutoff: float) -> tuple[Recording, ...]:
    count = _MULTIPLE * round(recording.duration / PIECE / _MULTIPLE)
    if count < 2:
        return (recording,)
    n = len(recording.t)
    rate = (n - 1) / recording.duration
    # The rows of a slow log come from a slower filter (`FilterSettings.cutoff`).
    over = round(compute_piece_overlap(min(cutoff, 0.08 * rate), rate) * rate)
    edges = np.linspace(0, n, count + 1).astype(int)
    return tuple(
        slice_recording(recording, max(a - over, 0), min(b + over, n)) for a, b in pairwise(edges)
    )


def compute_piece_overlap(cutoff: float, rate: float) -> float:
    """Overlap of a piece with its neighbours, at both ends [s]."""
    return float(np.ceil(FORGETS / cutoff * rate)) / rate


def slice_recording(recording: Recording, start: int, stop: int) -> Recording:
    """Return the samples from ``start`` up to ``stop`` of a log, without a copy."""
    values = {f.name: getattr(recording, f.name) for f in fields(recording)}
    part = {k: x[start:stop] for k, x in values.items() if isinstance(x, np.ndarray)}
    return replace(recording, **part)


def pick_spread_pieces(
    recordings: Sequence[Recording],
    max_seconds: float | None = None,
    kept_seconds: float | None = None,
) -> Sequence[Recording]:
    """Return evenly spread pieces of long logs, or the logs if they are not long.

    Args:
        max_seconds: Length from which they are long; None for ten minutes.
        kept_seconds: Kept length; None for seven minutes.
    """
    max_seconds = LONG if max_seconds is None else max_seconds
    total = sum(r.duration for r in recordings)
    if not exceed_split_length(recordings) and total <= max_seconds:
        return recordings
    pieces = [piece for r in recordings for piece in _pieces(r, CUTOFF)]
    seconds = [r.duration for r in pieces]
    return [pieces[i] for i in choose_spread_pieces(seconds, max_seconds, kept_seconds)]


def release_mapped_memory(recording: Recording) -> None:
    """Release memory-mapped samples; they are reloaded when read."""
    for array in (recording.q, recording.tau):
        while isinstance(array, np.ndarray):
            array = array.base
        if isinstance(array, mmap.mmap):
            array.madvise(mmap.MADV_DONTNEED)


def flag_repeated_ids(ids: Sequence[str]) -> list[bool]:
    """Return for each log whether it is a piece of one: its id is repeated."""
    return [ids.count(log_id) > 1 for log_id in ids]


def group_pieces_by_log(ids: Sequence[str]) -> list[list[int]]:
    """Numbers of the pieces of each log, by their ids."""
    by_id = groupby(range(len(ids)), key=lambda i: ids[i])
    return [list(numbers) for _, numbers in by_id]


def choose_spread_pieces(
    seconds: Sequence[float], max_seconds: float | None = None, kept_seconds: float | None = None
) -> list[int]:
    """Choose evenly spread pieces of long logs, by number; all of short ones.

    Args:
        seconds: Length of each piece [s].
        max_seconds: Total length from which a choice is made; None for ten minutes.
        kept_seconds: Chosen length; None for seven minutes.
    """
    total = float(sum(seconds))
    if total <= (LONG if max_seconds is None else max_seconds):
        return list(range(len(seconds)))
    middle = np.cumsum(seconds) - 0.5 * np.asarray(seconds)
    kept_seconds = SKETCH if kept_seconds is None else kept_seconds
    count = max(int(kept_seconds / max(seconds)), 1)
    times = (np.arange(count) + 0.5) / count * total
    return sorted({int(np.argmin(np.abs(middle - at))) for at in times})


def find_session_start(recordings: Sequence[Recording]) -> float | None:
    """Start of the session if the logs' times show their order, else None [s]."""
    spans = sorted((float(r.t[0]), float(r.t[-1])) for r in recordings)
    ordered = all(a[1] < b[0] for a, b in pairwise(spans))
    return spans[0][0] if ordered else None


def split_off_last_quarter(fit: Sequence[Recording]) -> tuple[list[Recording], list[Recording]]:
    """Cut the last quarter off the longest log and hold it out."""
    longest = max(fit, key=lambda r: r.duration)
    cut = longest.t[0] + 0.75 * longest.duration
    row = int(np.searchsorted(longest.t, cut))
    head = slice_recording(longest, 0, row)
    tail = slice_recording(longest, row, len(longest.t))
    tail = replace(tail, id=f"{longest.id} (last quarter)")
    return [head if r is longest else r for r in fit], [tail]
