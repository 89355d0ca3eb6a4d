"""Logs in their order of time, and the part of them that is held out."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from residual.recording import Recording
from residual.signals.pieces import rows_of


def session_clock(recordings: Sequence[Recording]) -> float | None:
    """Start of the session if the logs' times show their order, else None [s]."""
    spans = sorted((float(r.t[0]), float(r.t[-1])) for r in recordings)
    ordered = all(a[1] < b[0] for a, b in pairwise(spans))
    return spans[0][0] if ordered else None


def hold_out_end(
    fit: Sequence[Recording],
) -> tuple[list[Recording], list[Recording]]:
    """Cut the last quarter off the longest log and hold it out."""
    longest = max(fit, key=lambda r: r.duration)
    cut = longest.t[0] + 0.75 * longest.duration
    row = int(np.searchsorted(longest.t, cut))
    head, tail = rows_of(longest, 0, row), rows_of(longest, row, len(longest.t))
    tail = replace(tail, id=f"{longest.id} (last quarter)")
    return [head if r is longest else r for r in fit], [tail]
