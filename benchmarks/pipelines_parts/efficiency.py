"""Two processes against one: the same real experiments."""

import os
from pathlib import Path
from time import perf_counter

from benchmarks.figures import Figures, figure, missing

_BAR, _IDLE = 0.8, 0.3


def efficiency_figures(folder: Path, quick: bool) -> Figures:
    """Return the share of the time of one process that two need, halved."""
    name = "parallel_efficiency"
    load = os.getloadavg()[0]
    if quick:
        return {name: missing(_BAR, "one process alone takes the time of a quick run")}
    if load >= _IDLE:
        why = f"load average {load:.2f} before, expected under {_IDLE}"
        return {name: missing(_BAR, why)}
    count = 12
    one, two = (_seconds(folder / str(n), n, count) for n in (1, 2))
    value = one / (2 * two)
    entry = figure(value, _BAR, count, ok=value >= _BAR, at_least=True, load=load)
    return {name: {**entry, "seconds": [round(one, 1), round(two, 1)]}}


def _seconds(store: Path, processes: int, count: int) -> float:
    from flows.specs.experiment import experiment_of
    from flows.steps.campaign import run_all
    from flows.steps.experiment import load_engine, plan
    from flows.workers.pool import Pool

    specs = [experiment_of({"seed": seed}, "C") for seed in range(count)]
    planned = plan(((str(s.seed), s) for s in specs), store)
    with Pool(processes) as pool:
        # Loaded before the clock starts, in both: a long campaign loads it once.
        list(pool.run(_ready, [load_engine.__name__] * processes))
        start = perf_counter()
        summary = run_all(planned, store, pool=pool)
    assert not summary.failures
    return perf_counter() - start


def _ready(_: str) -> None:
    from flows.steps.experiment import load_engine

    load_engine()
