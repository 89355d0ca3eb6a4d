"""Group 2: a store with ten thousand runs."""

import multiprocessing
from collections.abc import Callable
from pathlib import Path
from time import perf_counter

import numpy as np

import warehouse
from benchmarks.figures import Figures, figure, partial
from benchmarks.store_parts.made import folder, small
from warehouse.catalogue import flush
from warehouse.commit import commit_run
from warehouse.query.store import Store
from warehouse.runs import read_run

FULL = 10_000
ERRORS = """
    SELECT trajectory, joint, avg(value), max(value) FROM errors
    WHERE metric = 'rms_e_tau' GROUP BY ALL
"""


def many_figures(count: int, rounds: int) -> Figures:
    """Fill a store through the real commit, then open and ask it."""
    with folder() as place:
        start = perf_counter()
        _fill(place, count)
        filled = perf_counter() - start
        first = _timed(lambda: warehouse.open(place).close())
        figures = {
            "first_open_s": figure(first, None, 1, what="after the writers, no reader")
        }
        figures |= _asked(place, rounds, "")
        with warehouse.open(place) as store:
            packing = _timed(store.compact)
        figures |= _asked(place, rounds, "_compact")
        figures["compact_s"] = figure(packing, None, 1)
        index = sum(p.stat().st_size for p in (place / "_index").iterdir())
    figures["fill_ms_per_run"] = figure(1e3 * filled / count, None, count, writers=2)
    figures["index_mb"] = figure(index / 1e6, None, 1)
    if count == FULL:
        return figures
    why = f"with {count} runs instead of {FULL}"
    return {name: partial(entry, why) for name, entry in figures.items()}


def _asked(place: Path, rounds: int, tail: str) -> Figures:
    opening = [_timed(lambda: warehouse.open(place).close()) for _ in range(rounds)]
    with warehouse.open(place) as store:
        ids = store.sql("SELECT run_id FROM runs")["run_id"].to_pylist()
        some = np.random.default_rng(0).choice(ids, rounds)
        figures = {
            f"open{tail}_s": _median(opening, 1.0),
            f"runs_query{tail}_s": _asking(store, rounds, 0.5, lambda _: "FROM runs"),
            f"error_aggregate{tail}_s": _asking(store, rounds, 1.0, lambda _: ERRORS),
            f"one_run_row{tail}_s": _asking(
                store, rounds, 0.05, lambda k: f"FROM runs WHERE run_id = '{some[k]}'"
            ),
            # No bar: what a question about the samples themselves costs.
            f"one_run_samples_by_sql{tail}_s": _asking(
                store,
                rounds,
                None,
                lambda k: f"SELECT avg(tau1) FROM samples WHERE run_id = '{some[k]}'",
            ),
            f"all_samples_by_sql{tail}_s": _asking(
                store, 1, None, lambda _: "SELECT avg(tau1) FROM samples"
            ),
        }
    reading = [_timed(lambda id=id: read_run(place, id)) for id in some]
    figures[f"one_run_read{tail}_s"] = _median(reading, 0.05)
    return figures


def _asking(
    store: Store, rounds: int, bar: float | None, query: Callable[[int], str]
) -> dict:
    spent = [_timed(lambda k=k: store.sql(query(k))) for k in range(rounds)]
    return _median(spent, bar)


def _median(spent: list[float], bar: float | None) -> dict:
    return figure(float(np.median(spent)), bar, len(spent), most=max(spent))


def _timed(job: Callable[[], object]) -> float:
    start = perf_counter()
    job()
    return perf_counter() - start


def _fill(place: Path, count: int) -> None:
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__])
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
    flush()
