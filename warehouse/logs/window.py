"""What the words FILE@start:end stand for, and whether two logs share samples."""

import os
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

from residual.errors import InputError
from residual.names import shortened
from residual.recording import Recording

Array = np.ndarray

_EDGE = r"(\d+(?:\.\d*)?|\.\d+)(%?)"
_WINDOW = re.compile(f"(?:{_EDGE})?:(?:{_EDGE})?")


# So many equal samples in a row are no coincidence, however coarse the sensors.
RUN = 5
BLOCK = 1 << 17  # samples that are looked at together


@dataclass(frozen=True, slots=True)
class Window:
    """A span of a log: [start, end) in time from its first sample.

    Attributes:
        text: As the user wrote it, without the "@".
        start: Start [s], or [%] of the whole time.
        end: End, None for the end of the log.
        start_percent: Whether start is a percentage.
        end_percent: Whether end is a percentage.
    """

    text: str
    start: float = 0.0
    end: float | None = None
    start_percent: bool = False
    end_percent: bool = False

    def rows(self, t: Array, where: str) -> slice:
        """Return the rows of the window.

        Args:
            t: Sample times, strictly increasing [s]. Shape (n,).
        """
        step = float(np.median(np.diff(t)))
        # One step longer than last minus first, so that 100 % has the last sample.
        whole = float(t[-1] - t[0]) + step
        start = self.start * whole / 100 if self.start_percent else self.start
        end = whole if self.end is None else self.end
        end = end * whole / 100 if self.end_percent else end
        if start >= whole - step / 2 or end > whole + step / 2:
            raise InputError(
                f"{where}: window @{shortened(self.text)} is outside the log, which "
                f"lasts {whole:.6g} s. Times count from its first sample."
            )
        if end <= start:
            raise InputError(
                f"{where}: window @{shortened(self.text)} is empty: end before start."
            )
        # A hair early, so that 2.5 s is not missed by the rounding of a clock.
        edges = np.searchsorted(t - t[0], np.array([start, end]) - 1e-3 * step)
        last = len(t) if end >= whole - step / 2 else int(edges[1])
        return slice(int(edges[0]), last)


def split_spec(spec: str) -> tuple[Path, Window | None]:
    """Split the words for a log into its file and its window.

    Args:
        spec: "FILE" or "FILE@start:end"; a file of the full name wins.

    Returns:
        The file, and the window or None.
    """
    path = Path(spec)
    # Those of os.path, which say no of a name that no file can have.
    if "@" not in path.name or os.path.exists(path):
        return _existing(path), None
    name, _, text = spec.rpartition("@")
    match = _WINDOW.fullmatch(text)
    if match is None or not name:
        raise InputError(
            f"{shortened(path.name)}: window @{shortened(text)} is not understood, "
            "expected @start:end in seconds or percent, such as @0:16.5, @60%: or "
            "@:60%."
        )
    start, start_percent, end, end_percent = match.groups()
    window = Window(
        text,
        float(start or 0),
        None if end is None else float(end),
        bool(start_percent),
        bool(end_percent),
    )
    for edge, percent in ((start, start_percent), (end, end_percent)):
        if percent and float(edge) > 100:
            raise InputError(
                f"{shortened(path.name)}: {shortened(edge)}% is outside the log, "
                "expected 0 to 100 %."
            )
    return _existing(Path(name)), window


def unique_ids(specs: Sequence[str]) -> list[str]:
    """Return a short label for each log, no two alike.

    Returns:
        File stems with their windows; with folders, then with numbers, where alike.
    """
    parts = [split_spec(spec) for spec in specs]
    tails = ["" if window is None else f"@{window.text}" for _, window in parts]
    ids = [f"{path.stem}{tail}" for (path, _), tail in zip(parts, tails, strict=True)]
    longer = [
        f"{path.resolve().parent.name}/{path.name}{tail}"
        for (path, _), tail in zip(parts, tails, strict=True)
    ]
    counts = Counter(ids)
    ids = [a if counts[a] == 1 else b for a, b in zip(ids, longer, strict=True)]
    counts, seen = Counter(ids), Counter()
    for i, label in enumerate(ids):
        seen[label] += 1
        if counts[label] > 1:
            ids[i] = f"{label} ({seen[label]})"
    return ids


def _existing(path: Path) -> Path:
    if os.path.isfile(path / "metadata.yaml"):
        return path  # a bag of ROS 2
    if os.path.isdir(path):
        raise InputError(
            f"{path} is a folder, expected a log file, or the folder of a "
            "ROS 2 bag with its metadata.yaml."
        )
    if not os.path.exists(path):
        raise InputError(
            f"No log file '{shortened(path)}'. Give a CSV or Parquet file."
        )
    if not os.path.isfile(path):
        raise InputError(
            f"{path} is not a regular file, expected a CSV or Parquet file."
        )
    return path


def check_distinct(recordings: Sequence[Recording]) -> None:
    """Refuse logs that share samples: overlapping windows or a copy under any name.

    Samples are compared by position and torque, not by time, since a copy may have
    another clock.

    Raises:
        InputError: Naming the first two logs that share samples.
    """
    if len(recordings) < 2:
        return
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
    odd = np.random.default_rng(0).integers(2**63, size=(2, 64), dtype=np.uint64) | 1
    blocks = range(0, len(recording.t), BLOCK)
    sample = np.concatenate([_hashes(recording, start, odd[0]) for start in blocks])
    count = max(0, len(sample) - RUN + 1)
    runs = np.zeros(count, dtype=np.uint64)
    for k in range(RUN):
        runs += sample[k : k + count] * odd[1, k]
    return np.unique(runs)


def _hashes(recording: Recording, start: int, odd: Array) -> Array:
    """One number for each sample of a block that is not the one before."""
    rows = slice(max(start - 1, 0), start + BLOCK)
    values = np.hstack([recording.q[rows], recording.tau[rows]])
    # Standing still repeats one sample, in any log: count it once.
    changed = np.r_[start == 0, (np.diff(values, axis=0) != 0).any(axis=1)]
    bits = np.ascontiguousarray(values[changed]).view(np.uint64)
    mixed = (bits ^ (bits >> np.uint64(29))) * odd[: bits.shape[1]]
    return np.bitwise_xor.reduce(mixed ^ (mixed >> np.uint64(32)), axis=1)
