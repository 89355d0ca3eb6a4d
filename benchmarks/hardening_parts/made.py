"""A small store with every kind of committed record, and all that it answers."""

import shutil
from pathlib import Path

import pyarrow as pa

import warehouse
from benchmarks.store_parts.made import small
from warehouse.commit import Sealed, commit_record, commit_run
from warehouse.schema import KINDS, SEALED, all_views
from warehouse.verify import verify_all


def run(store: Path, seed: int) -> str:
    """Commit one small simulated run with its seal and return its id."""
    log, manifest, twin = small(seed)
    sealed = Sealed({"effects": [], "salt": f"s{seed}"}, {"q": log.q})
    return commit_run(store, log, manifest, sealed, twin)


def records(store: Path, runs: list[str]) -> list[str]:
    """Commit a model, a diagnosis and a report of some runs and return their ids."""
    table = {"curve": pa.table({"x": [0.5, 1.5, 2.5]})}
    about = {"robot": "irb140", "stage": "augmented"}
    model = commit_record(store, "models", about, table, {"fit": runs})
    found = {"robot": "irb140", "verdict": "effects", "model_id": model}
    diagnosis = commit_record(store, "diagnoses", found, None, {"fit": runs})
    page = {"report.html": b"<html></html>"}
    told = {"robot": "irb140", "kind": "demo"}
    return [
        model,
        diagnosis,
        commit_record(store, "reports", told, None, [diagnosis], page),
    ]


def filled(store: Path, runs: int = 3) -> list[str]:
    """Fill a store and return the ids of its runs."""
    ids = [run(store, seed) for seed in range(runs)]
    records(store, ids[:2])
    return ids


def committed(store: Path) -> list[Path]:
    """Return the files of all committed records."""
    folders = [kind.folder for kind in KINDS.values()] + [SEALED]
    paths = (p for name in folders for p in (store / name).rglob("*"))
    return sorted(p for p in paths if p.is_file())


def answers(store: Path) -> dict[str, pa.Table]:
    """Return all rows of all views, in an order of their own.

    Raises:
        InputError: If something that they need is damaged.
    """
    with warehouse.open(store) as opened:
        return {view: opened.sql(f"FROM {view} ORDER BY ALL") for view in all_views()}


def damaged(store: Path) -> list[str]:
    """Return what `verify` says against a store."""
    return [line for each in verify_all(store) for line in each.faults]


def without_index(store: Path) -> None:
    """Let the next reader read the records themselves."""
    shutil.rmtree(store / "_index", ignore_errors=True)
