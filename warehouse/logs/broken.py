"""Rows that no sensor wrote: without a number, beyond all measure, or out of time."""

from collections.abc import Mapping

import numpy as np

from residual.errors import RecordingError
from warehouse.logs.check import Doubt, check_time

Array = np.ndarray

LARGEST = 1e30  # in any SI unit: no sensor measures more, and sums of squares overflow


def whole_rows(t: Array, where: str) -> tuple[Array, tuple[Doubt, ...]]:
    """Return the rows whose time is a number and later than all before.

    Args:
        t: Times [s]. Shape (n,).

    Returns:
        Which rows to keep, shape (n,); and what is wrong with the others.
    """
    t = np.where(np.abs(t) < LARGEST, t, np.nan)
    try:
        check_time(t, where)
    except RecordingError as error:
        if len(t) < 2:
            raise
        latest = np.maximum.accumulate(np.where(np.isfinite(t), t, -np.inf))
        keep = np.isfinite(t) & (t > np.r_[-np.inf, latest[:-1]])
        words = f"{error} {_share(keep)}"
        return keep, (Doubt("clock", (), words),)
    return np.ones(len(t), bool), ()


def finite_rows(
    signals: Mapping[str, Array], where: str
) -> tuple[Array, tuple[Doubt, ...]]:
    """Return the rows in which every signal is a number that can be measured.

    Args:
        signals: Values by name. Shapes (n, dof).

    Returns:
        Which rows to keep, shape (n,); and what is wrong with the others.
    """
    # Not a number compares as false.
    bad = {k: ~((x > -LARGEST) & (x < LARGEST)) for k, x in signals.items()}
    keep = ~np.any([mask.any(axis=1) for mask in bad.values()], axis=0)
    doubts = []
    for name, mask in bad.items():
        joints = tuple(int(j) + 1 for j in np.flatnonzero(mask.any(axis=0)))
        if joints:
            row = int(np.argmax(mask.any(axis=1)))
            first = signals[name][row][mask[row]][0]
            what = f"{first:.3g}" if np.isfinite(first) else "NaN or infinite"
            words = (
                f"{where}: {name} is {what} at sample {row}. Cut the log "
                f"there with a window (FILE@start:end) or repair it. {_share(keep)}"
            )
            doubts.append(Doubt("spike", joints, words))
    return keep, tuple(doubts)


def _share(keep: Array) -> str:
    return f"{int(np.sum(~keep))} of {len(keep)} samples are such."
