"""What the check of samples costs a scan of all channels of many runs."""

from pathlib import Path
from time import perf_counter, process_time
from unittest.mock import patch

import numpy as np

import warehouse
from benchmarks.figures import Figures, figure, partial
from benchmarks.store_parts.made import folder, synthetic
from warehouse.commit import commit_run
from warehouse.query import store as query
from warehouse.schema import channel_names

FULL, ROWS = 1000, 1000


class Unwatched:
    """In place of the watched reads: nothing is logged and nothing checked."""

    def __init__(self, _: object) -> None:
        self.copies: dict = {}

    def forget(self) -> None:
        """Do nothing."""

    def broken(self) -> dict:
        """Find nothing."""
        return {}


def cost_figures(runs: int, rounds: int) -> Figures:
    """Time the same scan with and without the check, each newly opened.

    In pairs, whose order changes: what else the machine does meets both of a pair
    alike, so that it is in neither the ratio of a pair nor the median of the ratios.

    Args:
        runs: How many runs of 1000 samples and 43 columns.
    """
    with folder() as place:
        for seed in range(runs):
            log, twin = synthetic(seed, ROWS)
            spec = {"seed": seed, "trajectory": {"kind": "fourier"}}
            commit_run(place, log, {"spec": spec}, extra=twin)
        names = [
            name
            for signal in ("t", "q", "tau", "q_ref", "e_q", "e_qd", "e_qdd", "e_tau")
            for name in channel_names(signal, log.dof)
        ]
        asked = f"SELECT {', '.join(f'sum({name})' for name in names)} FROM samples"
        with warehouse.open(place) as opened:  # the index is made, the cache is warm
            opened.sql(asked)
        pairs = [_pair(place, asked, first=number % 2) for number in range(rounds)]
    # Pairs, checked and bare, clock and processors.
    times = np.array(pairs)
    ratios = times[:, 0] / times[:, 1] - 1
    low, cost, high = np.quantile(ratios[:, 0], [0.25, 0.5, 0.75]).round(3).tolist()
    entry = figure(
        cost,
        0.2,
        rounds,
        runs=runs,
        range=[low, high],
        seconds=np.median(times[:, :, 0], axis=0).round(3).tolist(),
        cpu_share=round(float(np.median(ratios[:, 1])), 3),
    )
    entry = entry if runs >= FULL else partial(entry, f"{runs} runs instead of {FULL}")
    return {"sql_check_share": entry}


def _pair(place: Path, asked: str, first: int) -> tuple:
    """Time a scan with the check and one without; ``first`` is which comes first."""
    out = {}
    for bare in (first, 1 - first):
        if bare:
            with patch.object(query, "Watched", Unwatched):
                out[1] = _timed(place, asked)
        else:
            out[0] = _timed(place, asked)
    return out[0], out[1]


def _timed(place: Path, asked: str) -> tuple[float, float]:
    """Return seconds on the clock and of the processors."""
    with warehouse.open(place) as opened:
        start = perf_counter(), process_time()
        opened.sql(asked)
        return perf_counter() - start[0], process_time() - start[1]
