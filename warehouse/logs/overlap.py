"""Whether two logs hold the same samples: a proof on those would prove nothing."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from residual.errors import InputError
from residual.recording import Recording

Array = np.ndarray

# So many equal samples in a row are no coincidence, however coarse the sensors.
RUN = 5


def check_distinct(recordings: Sequence[Recording]) -> None:
    """Refuse logs that share samples: overlapping windows or a copy under any name.

    Samples are compared by position and torque, not by time, since a copy may have
    another clock.

    Args:
        recordings: All logs of one diagnosis.

    Raises:
        InputError: Naming the first two logs that share samples.
    """
    prints = [_runs(recording) for recording in recordings]
    for i, j in combinations(range(len(recordings)), 2):
        shared = len(np.intersect1d(prints[i], prints[j], assume_unique=True))
        if shared:
            raise InputError(
                f"'{recordings[i].id}' and '{recordings[j].id}' hold the same samples "
                f"(about {shared + RUN - 1}). Give every sample once: other logs, or "
                "windows that do not overlap."
            )


def _runs(recording: Recording) -> Array:
    """Return one number for every RUN samples in a row, the same for equal ones."""
    rows = np.hstack([recording.q, recording.tau])
    # Standing still repeats one sample, in any log: count it once.
    changed = np.r_[True, (np.diff(rows, axis=0) != 0).any(axis=1)]
    bits = np.ascontiguousarray(rows[changed]).view(np.uint64)
    odd = np.random.default_rng(0).integers(2**63, size=(2, 64), dtype=np.uint64) | 1
    mixed = (bits ^ (bits >> np.uint64(29))) * odd[0, : bits.shape[1]]
    sample = np.bitwise_xor.reduce(mixed ^ (mixed >> np.uint64(32)), axis=1)
    count = max(0, len(sample) - RUN + 1)
    runs = np.zeros(count, dtype=np.uint64)
    for k in range(RUN):
        runs += sample[k : k + count] * odd[1, k]
    return np.unique(runs)
