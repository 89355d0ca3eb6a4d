"""Runs that the groups share, a store with every kind of record, and all it answers."""

import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa

import warehouse
from residual.recording import Recording
from residual.robot.robot import Robot
from warehouse.commit import Seal, commit_record, commit_run
from warehouse.schema import KINDS, SEALED, all_views
from warehouse.verify import verify_all

Array = np.ndarray

DOF = 6
FAMILIES = ("fourier", "cyclic", "move_stop_move", "welding")
# Of an encoder with 19 bits a turn.
_STEP = 2 * np.pi / 2**19


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


def synthetic(seed: int, rows: int) -> tuple[Recording, dict[str, Array]]:
    """Return signals as the plant logs them: 43 columns, of which 19 have no noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(rows) / 250
    q_ref = np.sin(t[:, None] * np.arange(1, 7) / 3 + rng.uniform(0, 6, DOF))

    def noisy(values: Array, spread: float) -> Array:
        return values + spread * rng.normal(size=values.shape)

    q = np.round(noisy(q_ref, 1e-4) / _STEP) * _STEP
    log = Recording("", "irb140", t, q, noisy(30 * q_ref, 0.02), q_ref=q_ref)
    twin = {"e_q": q - q_ref, "e_qd": 1e-2 * q_ref, "e_qdd": 1e-1 * q_ref}
    return log, twin | {"e_tau": noisy(q_ref, 0.02)}


def stand_in(seeds: Callable[[Any], Any], rows: int = 400) -> Callable:
    """Return what stands in for the simulated arm: arrays that its spec decides."""

    def simulate(spec: Any, robot: Robot, *_: object) -> tuple:
        rng = np.random.default_rng(seeds(spec))
        q, tau, e_q, e_tau = rng.normal(size=(4, rows, robot.dof))
        made = SimpleNamespace(
            log=Recording("", robot.name, np.arange(rows) / 100, q, tau),
            twin={"e_q": e_q, "e_tau": e_tau},
            truth={"q": q},
        )
        return made, {}

    return simulate


def run(store: Path, seed: int) -> str:
    """Commit one small simulated run with its seal and return its id."""
    log, manifest, twin = small(seed)
    sealed = Seal({"effects": [], "salt": f"s{seed}"}, {"q": log.q})
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


def filled(store: Path, runs: int = 3) -> list[str]:
    ids = [run(store, seed) for seed in range(runs)]
    records(store, ids[:2])
    return ids


def committed(store: Path) -> list[Path]:
    folders = [kind.folder for kind in KINDS.values()] + [SEALED]
    paths = (p for name in folders for p in (store / name).rglob("*"))
    return sorted(p for p in paths if p.is_file())


def answers(store: Path) -> dict[str, pa.Table]:
    """Return all rows of all views, in an order of their own."""
    with warehouse.open(store) as opened:
        return {view: opened.sql(f"FROM {view} ORDER BY ALL") for view in all_views()}


def damaged(store: Path) -> list[str]:
    """Return what `verify` says against a store."""
    return [line for each in verify_all(store) for line in each.faults]


def without_index(store: Path) -> None:
    """Let the next reader read the records themselves."""
    shutil.rmtree(store / "_index", ignore_errors=True)
