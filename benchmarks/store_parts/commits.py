"""Group 1: time and size of a commit against the bare Parquet file in the same run."""

from collections.abc import Callable
from pathlib import Path
from time import perf_counter

import numpy as np
import pyarrow.parquet as pq

from benchmarks.figures import Figures, figure, partial
from benchmarks.store_parts.made import folder, synthetic
from residual.recording import Recording
from warehouse.commit import commit_run
from warehouse.files import to_table, write_parquet

ROWS = 10_000
SIM = """
schema = 1
robot = "irb140"
seed = 9
[trajectory]
kind = "fourier"
duration = {seconds}
periods = 2
[plant]
scatter = 0.02
noise = {{torque = 0.015, encoder = 1e-4}}
[[plant.effect]]
name = "stribeck"
joints = [3]
level = 4.0
velocity = 0.05
[rates]
control = 1000
log = 250
"""


def commit_figures(rounds: int, simulated: bool) -> Figures:
    """Commit and write the same run in turn; the bare file is not flushed to the disk.

    Args:
        simulated: Whether to take a run of the plant; else signals with its noise.
    """
    log, twin = _plant() if simulated else synthetic(1, ROWS)
    what = "40 s of the plant" if simulated else "synthetic signals"
    arrays = {"t": log.t, "q": log.q, "tau": log.tau, "q_ref": log.q_ref, **twin}
    table = to_table(arrays, {})
    ours, bare = [], []
    with folder() as place:
        for seed in range(-2, rounds):
            manifest = {"spec": {"seed": seed, "trajectory": {"kind": "fourier"}}}
            spent = _timed(lambda m=manifest: commit_run(place, log, m, None, twin))
            alone = _timed(lambda: write_parquet(place / "bare.parquet", table))
            if seed >= 0:  # the first two load and warm
                ours.append(spent)
                bare.append(alone)
        pq.write_table(table, place / "default.parquet")
        size = _size(place / "bare.parquet") / _size(place / "default.parquet")
    median = float(np.median(ours))
    ratio = median / float(np.median(bare))
    about = {"rows": len(log.t), "columns": table.num_columns, "what": what}
    figures = {
        "commit_ms": figure(1e3 * median, 20.0, rounds, least=1e3 * min(ours), **about),
        "commit_over_bare_write": figure(ratio, 2.0, rounds, **about),
        "size_over_default": figure(size, 0.65, 1, **about),
    }
    if simulated:
        return figures
    why = "signals that stand in for those of the plant"
    return {name: partial(entry, why) for name, entry in figures.items()}


def _plant() -> tuple[Recording, dict]:
    from flows.specs.experiment import load_spec
    from flows.steps.experiment import make

    with folder() as place:
        path = place / "spec.toml"
        path.write_text(SIM.format(seconds=ROWS / 250))
        made = make(load_spec(path))
    return made.log, dict(made.twin)


def _timed(job: Callable[[], object]) -> float:
    start = perf_counter()
    job()
    return perf_counter() - start


def _size(path: Path) -> int:
    return path.stat().st_size
