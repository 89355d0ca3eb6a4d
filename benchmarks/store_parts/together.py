"""Group 3: three writers and a reader at once: no error, none partial, none lost."""

import multiprocessing
from pathlib import Path
from time import monotonic

import warehouse
from benchmarks.harness.figures import Figures, all_partial, figure
from benchmarks.store_parts.made import folder, small
from warehouse.commit import commit_run
from warehouse.runs import read_run

WRITERS, ROWS, FULL = 3, 400, 60.0


def together_figures(quick: bool) -> Figures:
    """Let three processes write for a while; every fifth run is of all of them."""
    seconds = 10.0 if quick else FULL
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__])
    told = context.Queue()
    with folder() as place:
        until = monotonic() + seconds
        writers = [
            context.Process(target=_write, args=(place, who, until, told))
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
        lost = written ^ _visible(place)
        broken = sum(_is_broken(place, id) for id in written)
        left = len(list((place / "_staging").iterdir()))
    about = {"seconds": seconds, "runs": len(written), "sweeps": sweeps}
    figures = {
        "together_errors": figure(len(errors), 0, len(written), told=errors[:3]),
        "together_partial_runs": figure(partly + broken, 0, sweeps, **about),
        "together_lost_runs": figure(len(lost), 0, len(written), **about),
        "together_left_in_staging": figure(left, 0, len(written)),
    }
    why = f"{seconds:g} s instead of {FULL:g} s" if quick else ""
    return all_partial(figures, why)


def _write(place: Path, who: int, until: float, told) -> None:
    ids, errors, count = [], [], 0
    while monotonic() < until:
        seed = count if count % 5 == 0 else (who + 1) * 1_000_000 + count
        try:
            log, manifest, twin = small(seed, ROWS)
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


def _visible(place: Path) -> set[str]:
    with warehouse.open(place) as store:
        return set(store.sql("SELECT run_id FROM runs")["run_id"].to_pylist())


def _is_broken(place: Path, id: str) -> bool:
    try:
        return len(read_run(place, id).t) != ROWS
    except Exception:
        return True
