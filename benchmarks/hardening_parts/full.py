"""A disk that is full, at one moment after the other of what writes into a store."""

import errno
import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from unittest.mock import patch

import pyarrow.parquet as pq

from benchmarks.figures import Figures, figure, partial
from benchmarks.hardening_parts.made import answers, damaged, filled, records, run
from benchmarks.store_parts.made import folder
from warehouse.bundle import read_bundle, write_bundle
from warehouse.query.store import open_store

FULL = 10
# What asks the disk for room: in place of a small disk, which takes rights to mount.
_WRITERS = (
    (os, "mkdir"),
    (os, "fsync"),
    (os, "rename"),
    (os, "replace"),
    (pq, "write_table"),
    (Path, "write_bytes"),
)


def full_figures(moments: int) -> Figures:
    """Let the disk be full at the first, second, ... write of each operation."""
    bad, met, count = [], 0, 0
    for name, prepare in _OPERATIONS.items():
        for moment in range(1, moments + 1):
            with folder() as place:
                count += 1
                work = prepare(place)
                failed, wrong = _one(place / "store", work, moment)
                met += failed
                bad += [f"{name} at write {moment}: {line}" for line in wrong]
    entry = figure(len(bad), 0, count, told=bad[:5], failures_met=met)
    if moments < FULL:
        entry = partial(entry, f"{moments} moments instead of {FULL}")
    return {"full_disk_not_whole": entry}


def _one(store: Path, work: Callable, moment: int) -> tuple[bool, list[str]]:
    before = answers(store)
    failed, wrong = False, []
    with _full_from(moment):
        try:
            work()
        except OSError as error:
            failed = error.errno == errno.ENOSPC
            if not failed:
                wrong.append(f"another error: {error}")
    wrong += damaged(store)
    given = answers(store)
    # What was there is there: rows may have come, and none have gone or changed.
    for view, rows in before.items():
        left = set(map(repr, rows.to_pylist())) - set(
            map(repr, given[view].to_pylist())
        )
        if left:
            wrong.append(f"{view} has lost {len(left)} rows")
    if any((store / "_staging").iterdir()):
        wrong.append("something is left in _staging")
    work()
    return failed, wrong + damaged(store)


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


def _commit(place: Path) -> Callable:
    filled(place / "store")
    return lambda: run(place / "store", 7)


def _record(place: Path) -> Callable:
    ids = filled(place / "store")
    return lambda: records(place / "store", ids[1:])


def _compact(place: Path) -> Callable:
    filled(place / "store")

    def work() -> None:
        with open_store(place / "store") as opened:
            opened.compact()

    return work


def _unbundle(place: Path) -> Callable:
    other = place / "other"
    ids = [run(other, seed) for seed in (8, 9)]
    model = records(other, ids)[1]
    write_bundle(other, model, place / "b.tar")
    filled(place / "store")
    return lambda: read_bundle(place / "b.tar", place / "store")


_OPERATIONS = {
    "commit": _commit,
    "record": _record,
    "compact": _compact,
    "unbundle": _unbundle,
}
