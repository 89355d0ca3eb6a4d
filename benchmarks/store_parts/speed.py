"""Time of a commit against the bare Parquet file, and of ten thousand runs."""

import multiprocessing
import os
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import duckdb
import numpy as np
import pyarrow.parquet as pq

from benchmarks.harness.figures import Figures, figure
from benchmarks.harness.logs import reference
from benchmarks.harness.rates import wall
from benchmarks.store_parts.records import small
from residual.robot.robot import load_robot
from sim.engine.plant_records import PlantSpec, SampleRates, SensorNoise, TrajectorySpec
from sim.experiment import run_experiment
from warehouse.queries import open_store
from warehouse.record_commit import commit_run
from warehouse.store_catalogue import read_run
from warehouse.store_files import arrays_to_table, write_parquet

ROWS = 10_000
_BUSY = 3.0  # load, that of this benchmark included


def commit_figures(quick: bool) -> Figures:
    """Commit 40 s of the plant, in turn with a bare file that is not flushed."""
    rounds = 15 if quick else 60
    spec = TrajectorySpec("fourier", ROWS / 250, 2, 9)
    plant = PlantSpec((), noise=SensorNoise(), seed=9)
    robot = load_robot("irb140")
    made = run_experiment(robot, reference(robot, spec), plant, SampleRates(), 0.0)
    log, twin = made.log, dict(made.twin)
    arrays = {"t": log.t, "q": log.q, "tau": log.tau, "q_ref": log.q_ref, **twin}
    table = arrays_to_table(arrays, {})
    ours, bare = [], []
    with TemporaryDirectory() as folder:
        place = Path(folder)
        for seed in range(-2, rounds):
            manifest = {"spec": {"seed": seed, "trajectory": {"kind": "fourier"}}}
            commit = wall(lambda m=manifest: commit_run(place, log, m, None, twin))
            write = wall(lambda: write_parquet(place / "bare.parquet", table))
            if seed >= 0:  # the first two load libraries
                ours.append(commit)
                bare.append(write)
        pq.write_table(table, place / "default.parquet")
        files = (place / f"{name}.parquet" for name in ("bare", "default"))
        size, default = (file.stat().st_size for file in files)
    median, peer = float(np.median(ours)), float(np.median(bare))
    return {
        "commit_ms": _idle(figure(1e3 * median, 20.0, rounds, rows=len(log.t))),
        "commit_over_bare_write": figure(median / peer, 2.0, rounds),
        "size_over_default": figure(size / default, 0.65, 1, columns=table.num_columns),
    }


def _idle(entry: dict) -> dict:
    """Return a figure in seconds without a result if other programs use the machine."""
    load = os.getloadavg()[0]
    if load <= _BUSY or entry["ok"] is not False:
        return entry
    why = f"the load is {load:.1f}; the bar is for an idle machine"
    return {**entry, "ok": None, "why": why}


FULL = 10_000
ERRORS = """
    SELECT trajectory, joint, avg(value), max(value) FROM errors
    WHERE metric = 'rms_e_tau' GROUP BY ALL
"""


def many_figures(quick: bool) -> Figures:
    count, rounds = (600, 5) if quick else (FULL, 15)
    with TemporaryDirectory() as folder:
        place = Path(folder)
        filled = wall(lambda: _fill(place, count))
        first = wall(lambda: open_store(place).close())
        figures = {"first_open_s": figure(first, None, 1)} | _figures(place, rounds)
    figures["fill_ms_per_run"] = figure(1e3 * filled / count, None, count, writers=2)
    return figures


def _figures(place: Path, rounds: int) -> Figures:
    opening = [wall(lambda: open_store(place).close()) for _ in range(rounds)]
    figures = {"open_s": _median(opening, 1.0)}
    with open_store(place) as store:
        ids = store.sql("SELECT run_id FROM runs")["run_id"].to_pylist()
        some = np.random.default_rng(0).choice(ids, rounds)
        one, samples = "WHERE run_id = '{}'", "SELECT avg(tau1) FROM samples"
        questions = {
            "runs_query": (0.5, "FROM runs", some),
            "error_aggregate": (1.0, ERRORS, some),
            "one_run_row": (0.05, f"FROM runs {one}", some),
            # No bar: what a question about the samples themselves costs.
            "one_run_samples_by_sql": (None, f"{samples} {one}", some),
            "all_samples_by_sql": (None, samples, some[:1]),
        }
        for name, (bar, query, each) in questions.items():
            spent = [wall(partial(store.sql, query.format(id))) for id in each]
            figures[f"{name}_s"] = _median(spent, bar)
        rows = store.sql("FROM errors")
    # The peer: the rows in one Parquet file, asked by DuckDB without a store.
    pq.write_table(rows, place / "errors.parquet")
    alone = ERRORS.replace("FROM errors", f"FROM '{place / 'errors.parquet'}'")
    with duckdb.connect() as peer:
        spent = [wall(lambda: peer.sql(alone).fetchall()) for _ in some]
    figures["error_aggregate_by_duckdb_s"] = figure(float(np.median(spent)), None, rounds)
    reading = [wall(lambda id=id: read_run(place, id)) for id in some]
    figures["one_run_read_s"] = _median(reading, 0.05)
    return figures


def _median(spent: list[float], bar: float | None) -> dict:
    return _idle(figure(float(np.median(spent)), bar, len(spent), most=max(spent)))


def _fill(place: Path, count: int) -> None:
    half = count // 2
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__])
    with ProcessPoolExecutor(2, context) as pool:
        list(pool.map(_write, (place, place), (0, half), (half, count)))


def _write(place: Path, start: int, end: int) -> None:
    # Ten thousand runs flushed one by one are a benchmark of the disk.
    import warehouse.record_commit
    import warehouse.store_files

    warehouse.store_files.flush_to_disk = warehouse.record_commit.flush_to_disk = lambda path: None
    for seed in range(start, end):
        log, manifest, twin = small(seed)
        commit_run(place, log, manifest, None, twin)
