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
    """Time the same scan with and without the check, in turns, each newly opened.

    Args:
        runs: How many runs of 1000 samples and 43 columns.
        rounds: How often.
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
        checked, bare = [], []
        for _ in range(rounds):
            with patch.object(query, "Watched", Unwatched):
                bare.append(_timed(place, asked))
            checked.append(_timed(place, asked))
    seconds, cores = np.transpose([checked, bare], (2, 0, 1)).min(axis=2)
    # Of the quickest rounds: what else the machine does makes the others slower. Time
    # of the processors is told too, which it disturbs less.
    about = {"seconds": seconds.round(3).tolist(), "cpu_s": cores.round(3).tolist()}
    cost = round(float(seconds[0] / seconds[1] - 1), 3)
    about["cpu_share"] = round(float(cores[0] / cores[1] - 1), 3)
    entry = figure(cost, 0.2, rounds, runs=runs, **about)
    entry = entry if runs >= FULL else partial(entry, f"{runs} runs instead of {FULL}")
    return {"sql_check_share": entry}


def _timed(place: Path, asked: str) -> tuple[float, float]:
    """Return seconds on the clock and of the processors."""
    with warehouse.open(place) as opened:
        start = perf_counter(), process_time()
        opened.sql(asked)
        return perf_counter() - start[0], process_time() - start[1]
