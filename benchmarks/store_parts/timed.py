"""A commit against the bare Parquet file, ten thousand runs, three writers at once."""

from functools import partial
from pathlib import Path
from time import monotonic, perf_counter

import numpy as np
import pyarrow.parquet as pq

import warehouse
from benchmarks.harness.figures import Figures, all_partial, figure
from benchmarks.harness.rates import wall
from benchmarks.harness.shell import forked
from benchmarks.store_parts.made import folder, small, synthetic
from residual.recording import Recording
from warehouse.commit import commit_run
from warehouse.files import to_table, write_parquet
from warehouse.runs import read_run

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


def commit_figures(quick: bool) -> Figures:
    """Commit and write a run in turn; the bare file is not flushed to the disk."""
    rounds, simulated = (15, False) if quick else (60, True)
    log, twin = _plant() if simulated else synthetic(1, ROWS)
    what = "40 s of the plant" if simulated else "synthetic signals"
    arrays = {"t": log.t, "q": log.q, "tau": log.tau, "q_ref": log.q_ref, **twin}
    table = to_table(arrays, {})
    ours, bare = [], []
    with folder() as place:
        for seed in range(-2, rounds):
            manifest = {"spec": {"seed": seed, "trajectory": {"kind": "fourier"}}}
            spent = wall(lambda m=manifest: commit_run(place, log, m, None, twin))
            alone = wall(lambda: write_parquet(place / "bare.parquet", table))
            if seed >= 0:  # the first two load and warm
                ours.append(spent)
                bare.append(alone)
        pq.write_table(table, place / "default.parquet")
        files = (place / f"{name}.parquet" for name in ("bare", "default"))
        size, usual = (file.stat().st_size for file in files)
    median, theirs = float(np.median(ours)), float(np.median(bare))
    about = {"rows": len(log.t), "columns": table.num_columns, "what": what}
    figures = {
        "commit_ms": figure(1e3 * median, 20.0, rounds, least=1e3 * min(ours), **about),
        "commit_over_bare_write": figure(median / theirs, 2.0, rounds, **about),
        "size_over_default": figure(size / usual, 0.65, 1, **about),
    }
    why = "" if simulated else "signals that stand in for those of the plant"
    return all_partial(figures, why)


def _plant() -> tuple[Recording, dict]:
    from flows.specs.experiment import load_spec
    from flows.steps.experiment import make

    with folder() as place:
        path = place / "spec.toml"
        path.write_text(SIM.format(seconds=ROWS / 250))
        made = make(load_spec(path))
    return made.log, dict(made.twin)


FULL = 10_000
ERRORS = """
    SELECT trajectory, joint, avg(value), max(value) FROM errors
    WHERE metric = 'rms_e_tau' GROUP BY ALL
"""


def many_figures(quick: bool) -> Figures:
    """Fill a store through the real commit, then open and ask it."""
    count, rounds = (600, 5) if quick else (FULL, 15)
    with folder() as place:
        start = perf_counter()
        _fill(place, count)
        filled = perf_counter() - start
        first = wall(lambda: warehouse.open(place).close())
        figures = {
            "first_open_s": figure(first, None, 1, what="after the writers, no reader")
        }
        figures |= _asked(place, rounds)
        index = sum(p.stat().st_size for p in (place / "_index").iterdir())
    figures["fill_ms_per_run"] = figure(1e3 * filled / count, None, count, writers=2)
    figures["index_mb"] = figure(index / 1e6, None, 1)
    why = f"with {count} runs instead of {FULL}" if quick else ""
    return all_partial(figures, why)


def _asked(place: Path, rounds: int) -> Figures:
    opening = [wall(lambda: warehouse.open(place).close()) for _ in range(rounds)]
    figures = {"open_s": _median(opening, 1.0)}
    with warehouse.open(place) as store:
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
    reading = [wall(lambda id=id: read_run(place, id)) for id in some]
    figures["one_run_read_s"] = _median(reading, 0.05)
    return figures


def _median(spent: list[float], bar: float | None) -> dict:
    return figure(float(np.median(spent)), bar, len(spent), most=max(spent))


def _fill(place: Path, count: int) -> None:
    context = forked(__name__)
    half = count // 2
    jobs = [(place, 0, half), (place, half, count)]
    writers = [context.Process(target=_write, args=job) for job in jobs]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
    if any(writer.exitcode for writer in writers):
        raise RuntimeError("a writer failed")


def _write(place: Path, start: int, end: int) -> None:
    # Ten thousand runs flushed one by one are a benchmark of the disk.
    import warehouse.commit
    import warehouse.files

    warehouse.files.sync = warehouse.commit.sync = lambda path: None
    for seed in range(start, end):
        log, manifest, twin = small(seed)
        commit_run(place, log, manifest, None, twin)


WRITERS, _LONG, WHILE = 3, 400, 60.0


def together_figures(quick: bool) -> Figures:
    """Let three processes write for a while; every fifth run is of all of them."""
    seconds = 10.0 if quick else WHILE
    context = forked(__name__)
    told = context.Queue()
    with folder() as place:
        until = monotonic() + seconds
        writers = [
            context.Process(target=_write_together, args=(place, who, until, told))
            for who in range(WRITERS)
        ]
        for writer in writers:
            writer.start()
        sweeps, partly, errors = _read(place, until)
        written: set[str] = set()
        for _ in writers:
            ids, failed = told.get(timeout=60)
            written |= set(ids)
            errors += failed
        for writer in writers:
            writer.join()
        with warehouse.open(place) as store:
            seen = store.sql("SELECT run_id FROM runs")["run_id"].to_pylist()
        lost = written ^ set(seen)
        broken = sum(_is_broken(place, id) for id in written)
        left = len(list((place / "_staging").iterdir()))
    about = {"seconds": seconds, "runs": len(written), "sweeps": sweeps}
    figures = {
        "together_errors": figure(len(errors), 0, len(written), told=errors[:3]),
        "together_partial_runs": figure(partly + broken, 0, sweeps, **about),
        "together_lost_runs": figure(len(lost), 0, len(written), **about),
        "together_left_in_staging": figure(left, 0, len(written)),
    }
    why = f"{seconds:g} s instead of {WHILE:g} s" if quick else ""
    return all_partial(figures, why)


def _write_together(place: Path, who: int, until: float, told) -> None:
    ids, errors, count = [], [], 0
    while monotonic() < until:
        seed = count if count % 5 == 0 else (who + 1) * 1_000_000 + count
        try:
            log, manifest, twin = small(seed, _LONG)
            ids.append(commit_run(place, log, manifest, None, twin))
        except Exception as error:
            errors.append(repr(error))
        count += 1
    told.put((ids, errors))


def _read(place: Path, until: float) -> tuple[int, int, list[str]]:
    """Ask again and again; every run that is seen must have all of its samples."""
    sweeps, partly, errors = 0, 0, []
    while not place.joinpath("samples").is_dir() and monotonic() < until:
        pass
    while monotonic() < until:
        try:
            with warehouse.open(place) as store:
                for _ in range(3):
                    rows = store.sql(
                        "SELECT run_id, any_value(rows) AS rows, count(t) AS found "
                        "FROM runs LEFT JOIN samples USING (run_id) GROUP BY run_id"
                    ).to_pylist()
                    partly += sum(row["found"] != row["rows"] for row in rows)
                    errors += store.damaged
                    sweeps += 1
        except Exception as error:
            errors.append(repr(error))
    return sweeps, partly, errors


def _is_broken(place: Path, id: str) -> bool:
    try:
        return len(read_run(place, id).t) != _LONG
    except Exception:
        return True
