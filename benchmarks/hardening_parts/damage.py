"""A full disk, one flipped bit at many places, and what the check of samples costs.

The disk is full at one moment after the other of what writes into a store; bits are
those of its committed records; the cost is that of a scan of all channels of many runs.
"""

import errno
import os
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from time import perf_counter, process_time
from unittest.mock import patch

import duckdb
import numpy as np
import pyarrow.parquet as pq

import warehouse
from benchmarks.harness.figures import Figures, all_partial, figure
from benchmarks.store_parts import made as stores
from residual.errors import InputError
from warehouse.commit import commit_run
from warehouse.schema import channel_names

MOMENTS = 10
# What asks the disk for room: in place of a small disk, which takes rights to mount.
_WRITERS = (
    (os, "mkdir"),
    (os, "fsync"),
    (os, "rename"),
    (os, "replace"),
    (pq, "write_table"),
    (Path, "write_bytes"),
)


def full_figures(quick: bool) -> Figures:
    """Let the disk be full at the first, second, ... write of each operation."""
    moments = 3 if quick else MOMENTS
    bad, met, count = [], 0, 0
    for name, prepare in _OPERATIONS.items():
        for moment in range(1, moments + 1):
            with stores.folder() as place:
                count += 1
                work = prepare(place / "store", stores.filled(place / "store"))
                failed, wrong = _one(place / "store", work, moment)
                met += failed
                bad += [f"{name} at write {moment}: {line}" for line in wrong]
    entry = figure(len(bad), 0, count, told=bad[:5], failures_met=met)
    why = f"{moments} moments instead of {MOMENTS}" if quick else ""
    return all_partial({"full_disk_not_whole": entry}, why)


def _one(store: Path, work: Callable, moment: int) -> tuple[bool, list[str]]:
    before = stores.answers(store)
    failed, wrong = False, []
    with _full_from(moment):
        try:
            work()
        except OSError as error:
            failed = error.errno == errno.ENOSPC
            if not failed:
                wrong.append(f"another error: {error}")
    wrong += stores.damaged(store)
    given = stores.answers(store)
    # What was there is there: rows may have come, and none have gone or changed.
    for view, rows in before.items():
        there, still = (set(map(repr, r.to_pylist())) for r in (rows, given[view]))
        left = there - still
        if left:
            wrong.append(f"{view} has lost {len(left)} rows")
    if any((store / "_staging").iterdir()):
        wrong.append("something is left in _staging")
    work()
    return failed, wrong + stores.damaged(store)


@contextmanager
def _full_from(moment: int) -> Iterator[None]:
    calls = 0

    def counted(real: Callable) -> Callable:
        def write(*words: object, **more: object) -> object:
            nonlocal calls
            calls += 1
            if calls >= moment:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return real(*words, **more)

        return write

    with ExitStack() as stack:
        for owner, name in _WRITERS:
            stack.enter_context(
                patch.object(owner, name, counted(getattr(owner, name)))
            )
        yield


def _commit(store: Path, ids: list[str]) -> Callable:
    return lambda: stores.run(store, 7)


def _record(store: Path, ids: list[str]) -> Callable:
    return lambda: stores.records(store, ids[1:])


_OPERATIONS = {
    "commit": _commit,
    "record": _record,
}


PLACES = 500


def flip_figures(quick: bool) -> Figures:
    """Flip bits, half of them without an index; ask `verify`, and all of SQL."""
    places = 60 if quick else PLACES
    rng = np.random.default_rng(16)
    with stores.folder() as place:
        store = place / "store"
        stores.filled(store)
        wanted = stores.answers(store)
        missed, wrong, errors = [], [], Counter()
        paths = stores.committed(store)
        for number in range(places):
            # Every file equally often: small ones are as easily damaged as looked at.
            path = paths[number % len(paths)]
            good = path.read_bytes()
            at, bit = int(rng.integers(len(good))), int(rng.integers(8))
            path.write_bytes(good[:at] + bytes([good[at] ^ 1 << bit]) + good[at + 1 :])
            where = f"{path.relative_to(store)}:{at}.{bit}"
            if number // len(paths) % 2:
                stores.without_index(store)
            if not stores.damaged(store):
                missed.append(where)
            outcome = _asked(store, wanted)
            errors[outcome] += 1
            if outcome == "changed":
                wrong.append(where)
            path.write_bytes(good)
        whole = not stores.damaged(store)
        stores.without_index(store)
        whole = whole and _asked(store, wanted) == "same"
    figures = {
        "flips_not_found": figure(len(missed), 0, places, told=missed[:5]),
        "flips_other_answer": figure(
            len(wrong), 0, places, told=wrong[:5], sql_refused=errors["refused"]
        ),
        "flips_undone_not_whole": figure(int(not whole), 0, 1),
    }
    return all_partial(figures, f"{places} places instead of {PLACES}" if quick else "")


def _asked(store: Path, wanted: dict) -> str:
    try:
        given = stores.answers(store)
    except InputError:
        return "refused"
    same = all(given[view].equals(rows) for view, rows in wanted.items())
    return "same" if same else "changed"


RUNS, ROWS = 1000, 1000


def cost_figures(quick: bool) -> Figures:
    """Time the same scan with the check and by DuckDB's own reader, each newly opened.

    In pairs, whose order changes: what else the machine does meets both of a pair
    alike, so that it is in neither the ratio of a pair nor the median of the ratios.
    The runs have 1000 samples and 43 columns.
    """
    runs, rounds = (100, 3) if quick else (RUNS, 15)
    with stores.folder() as place:
        for seed in range(runs):
            log, twin = stores.synthetic(seed, ROWS)
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
        0.5,
        rounds,
        runs=runs,
        range=[low, high],
        seconds=np.median(times[:, :, 0], axis=0).round(3).tolist(),
        cpu_share=round(float(np.median(ratios[:, 1])), 3),
    )
    why = f"{runs} runs instead of {RUNS}" if quick else ""
    return all_partial({"sql_check_share": entry}, why)


def _pair(place: Path, asked: str, first: int) -> tuple:
    """Time a scan with the check and one without; ``first`` is which comes first."""
    out = {}
    for bare in (first, 1 - first):
        out[bare] = _plain(place, asked) if bare else _timed(place, asked)
    return out[0], out[1]


def _timed(place: Path, asked: str) -> tuple[float, float]:
    with warehouse.open(place) as opened:
        return _clocked(lambda: opened.sql(asked))


def _plain(place: Path, asked: str) -> tuple[float, float]:
    files = [str(path) for path in place.glob("samples/*/*/part-0.parquet")]
    with duckdb.connect() as plain:
        made = f"CREATE VIEW samples AS FROM read_parquet({files}, union_by_name=false)"
        plain.execute(made)
        return _clocked(lambda: plain.sql(asked).fetchall())


def _clocked(ask: Callable[[], object]) -> tuple[float, float]:
    start = perf_counter(), process_time()
    ask()
    return perf_counter() - start[0], process_time() - start[1]
