"""Blocks within runs: what is left out where runs are few.

Of three runs one can be left out, but then two are left to choose tables by, and two
agree by chance. Consecutive blocks of each run are more, but weaker proof: the other
blocks of the run are of the same motion, drives as warm and payload.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from residual.recording import Array
from residual.signals.track import Track

BLOCKS = 4  # of a run
FEW = 4  # runs under which leaving one out leaves fewer than three
GUARD = 0.25  # s, beside a block that is left out: filters and friction remember


@dataclass(frozen=True, slots=True)
class Part:
    """A block of a run.

    Attributes:
        run: Number of the run.
        begin, end: From when on, and until when, on the log's own clock [s].
    """

    run: int
    begin: float
    end: float

    def rows(self, t: Array, guard: float = 0.0) -> Array:
        """Whether times of its run are in it, or so close to it. Shape (n,), bool."""
        return (t >= self.begin - guard) & (t < self.end + guard)


def cut_parts(times: Sequence[Array]) -> tuple[Part, ...]:
    """Cut every run into blocks of equally many rows.

    Args:
        times: Times of the rows of each run [s]. Shapes (n,).
    """
    out = []
    for run, t in enumerate(times):
        inner = t[np.arange(1, BLOCKS) * len(t) // BLOCKS]
        ends = (-np.inf, *map(float, inner), np.inf)
        out += [Part(run, a, b) for a, b in pairwise(ends)]
    return tuple(out)


def part_of_rows(parts: Sequence[Part], times: Sequence[Array]) -> tuple[Array, Array]:
    """Return the part of every row, and the other part that it is close to.

    Args:
        times: Times of the rows of each run [s]. Shapes (n,).

    Returns:
        Numbers of parts; -1 where no other part is close. Shapes (n,), all runs.
    """
    own, near = [], []
    for run, t in enumerate(times):
        inside, beside = np.zeros(len(t), int), np.full(len(t), -1)
        for number, part in enumerate(parts):
            if part.run != run:
                continue
            within = part.rows(t)
            inside[within] = number
            beside[part.rows(t, GUARD) & ~within] = number
        own.append(inside)
        near.append(beside)
    return np.concatenate(own), np.concatenate(near)


def label_rows(tracks: Sequence[Track], parts: Sequence[Part]) -> list[Array]:
    """Number the rows by part: three for each, its inside and both of its edges.

    Returns:
        3 times the part's number, and 0, 1 or 2 for rows close to the part before, to
        none and to the part after. Shapes (m,).
    """
    out = []
    for run, track in enumerate(tracks):
        t, labels = _times(track), np.zeros(len(track.tau), dtype=int)
        for number, part in enumerate(parts):
            if part.run == run:
                place = 1 - (t < part.begin + GUARD) + (t >= part.end - GUARD)
                labels = np.where(part.rows(t), 3 * number + place, labels)
        out.append(labels)
    return out


def folds_without(parts: Sequence[Part], left_out: Collection[int]) -> Array:
    """Return the labels of the rows that are neither left out nor close to that."""

    def near(number: int, other: int) -> bool:
        same = 0 <= other < len(parts) and parts[other].run == parts[number].run
        return same and other in left_out

    kept = []
    for number in (n for n in range(len(parts)) if n not in left_out):
        kept += [] if near(number, number - 1) else [3 * number]
        kept += [3 * number + 1]
        kept += [] if near(number, number + 1) else [3 * number + 2]
    return np.array(kept, dtype=int)


def tracks_without(
    tracks: Sequence[Track], parts: Sequence[Part], left_out: Collection[int]
) -> tuple[Track, ...]:
    """Return what is left of each track.

    Args:
        left_out: Numbers of the parts that must not be seen.
    """
    out = []
    for run, track in enumerate(tracks):
        own = [n for n, part in enumerate(parts) if part.run == run]
        gone = [n for n in own if n in left_out]
        if len(gone) == len(own):
            continue
        out.append(_masked(track, [parts[n] for n in gone]))
    return tuple(out)


def _masked(track: Track, parts: Sequence[Part]) -> Track:
    if not parts:
        return track
    t = _times(track)
    kept = ~np.any([part.rows(t, GUARD) for part in parts], axis=0)
    return replace(track, inner=track.inner & kept, moving=track.moving & kept[:, None])


def _times(track: Track) -> Array:
    """Times of a track's rows on the log's own clock [s]. Shape (m,)."""
    return track.t[:: track.step][: len(track.tau)]
