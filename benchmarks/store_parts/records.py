"""Small runs and records of every kind, for stores."""

import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pyarrow as pa

from residual.recording import Recording
from warehouse.record_commit import commit_record, commit_run
from warehouse.store_catalogue import SealedTruth

Array = np.ndarray

DOF = 6
FAMILIES = ("fourier", "cyclic", "move_stop_move", "welding")


@contextmanager
def folder() -> Iterator[Path]:
    """Give a folder of one's own; nothing of it stays."""
    place = Path(tempfile.mkdtemp(prefix="modelgap-store-"))
    try:
        yield place
    finally:
        shutil.rmtree(place, ignore_errors=True)


def small(seed: int, rows: int = 50) -> tuple[Recording, Mapping, dict[str, Array]]:
    """Return a small run: its log, its manifest, the errors of its twin."""
    rng = np.random.default_rng(seed)
    q, tau = rng.normal(size=(2, rows, DOF))
    log = Recording("", "irb140", np.arange(rows) / 250, q, tau)
    kind = FAMILIES[seed % len(FAMILIES)]
    manifest = {"spec": {"seed": seed, "trajectory": {"kind": kind}}}
    return log, manifest, {"e_q": q / 10, "e_tau": tau / 10}


def run(store: Path, seed: int) -> str:
    log, manifest, twin = small(seed)
    sealed = SealedTruth({"effects": [], "salt": f"s{seed}"}, {"q": log.q})
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
    report = commit_record(store, "reports", told, None, [diagnosis], page)
    return [model, diagnosis, report]
