"""Which fold each row of the logs is in."""

from collections.abc import Iterator, Sequence

import numpy as np

from residual.recording import Array
from residual.signals.pieces import logs_of
from residual.signals.track import Track

BLOCKS_OF_ONE_LOG, BLOCKS_OF_A_LOG, ENOUGH_LOGS = 6, 3, 4


def fold_labels(tracks: Sequence[Track]) -> list[Array]:
    """Fold of each row of the logs: a log, or blocks of it where logs are few."""
    logs, blocks = logs_of([track.id for track in tracks]), 1
    if len(logs) < ENOUGH_LOGS:
        blocks = BLOCKS_OF_ONE_LOG if len(logs) == 1 else BLOCKS_OF_A_LOG
    out = []
    for k, pieces in enumerate(logs):
        for i, number in enumerate(pieces):
            m = len(tracks[number].tau)
            # A piece of a log lies in one block of it (``signals.pieces``).
            within = (np.arange(m) if len(pieces) == 1 else np.full(m, i)) * blocks
            out.append(k * blocks + within // (m if len(pieces) == 1 else len(pieces)))
    return out


def rows_that_count(tracks: Sequence[Track]) -> list[Array]:
    """Rows on which each joint moves, in logs of a live torque. Shapes (m, dof)."""
    out = []
    for pieces in logs_of([t.id for t in tracks]):
        own = [tracks[i] for i in pieces]
        alive = np.any([np.ptp(t.tau, axis=0) > 0 for t in own], axis=0)
        out += [t.moving & alive for t in own]
    return out


def squares_per_fold(
    values: Sequence[Array], labels: Sequence[Array], folds: int
) -> Array:
    """Sum of squares per fold and joint, of rows and folds. Shape (folds, dof)."""
    pairs = zip(labels, values, strict=True)
    sums = [np.bincount(own, x**2, minlength=folds) for own, x in pairs]
    return np.stack(sums, axis=1)


def runs(labels: Array) -> Iterator[tuple[int, slice]]:
    """Folds of rows with their rows, which follow each other."""
    folds, starts = np.unique(labels, return_index=True)
    counts = np.bincount(labels)[folds]
    for fold, start, count in zip(folds, starts, counts, strict=True):
        yield int(fold), slice(int(start), int(start + count))
