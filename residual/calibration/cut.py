"""Logs cut to what a calibration can use: a single one to parts, long ones shorter."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from residual.calibration.rows import Run

PARTS = 5  # of a single log
MOST = 900.0  # s of logs in all


def cut_single(runs: Sequence[Run]) -> tuple[Run, ...]:
    """Cut a single log into parts, so that there is something to leave out."""
    if len(runs) != 1:
        return tuple(runs)
    (run,) = runs
    count = len(run.log.t)
    ends = np.linspace(0, count, PARTS + 1).astype(int)
    return tuple(
        _part(run, slice(a, b), f" part {i}")
        for i, (a, b) in enumerate(pairwise(ends), 1)
    )


def thinning(runs: Sequence[Run]) -> tuple[int, tuple[str, ...]]:
    """Return every how manieth row tables take of all logs, and that, a line.

    The model is identified from all of them, piece by piece.
    """
    total = sum(run.log.duration for run in runs)
    thin = max(1, int(np.ceil(total / MOST)))
    if thin == 1:
        return 1, ()
    return thin, (
        f"{total / 60:.3g} min of logs: the model is identified from all of them, "
        f"tables are fitted to one row in {thin}",
    )


def shorten(runs: Sequence[Run]) -> tuple[tuple[Run, ...], tuple[str, ...]]:
    """Keep the middle of every run where all of them are longer than tables can use.

    Of the paper's rows each needs the next one. Those of more than a quarter of an hour
    would take gigabytes and hours, and say what these say.

    Returns:
        The logs, each cut to the same share of its length, and what was done, a line.
    """
    total = sum(run.log.duration for run in runs)
    if total <= MOST:
        return tuple(runs), ()
    out = []
    for run in runs:
        count = len(run.log.t)
        kept = max(int(count * MOST / total), 2)
        first = (count - kept) // 2
        out.append(_part(run, slice(first, first + kept)))
    return tuple(out), (
        f"{total / 60:.3g} min of logs are more than tables are fitted to: of each of "
        f"{len(runs)} runs or parts the middle {100 * MOST / total:.2g} % was taken, "
        f"{MOST / 60:g} min in all. For others give windows, such as A.csv@0:600",
    )


def _part(run: Run, rows: slice, label: str = "") -> Run:
    log = run.log
    cut = {"t": log.t[rows], "q": log.q[rows], "tau": log.tau[rows]}
    for name in ("qd", "qdd", "q_ref"):
        if getattr(log, name) is not None:
            cut[name] = getattr(log, name)[rows]
    twin = {name: values[rows] for name, values in run.twin.items()}
    return replace(run, log=replace(log, id=f"{log.id}{label}", **cut), twin=twin)
