"""Small runs and a verdict to put into a store."""

import numpy as np

from flows.storage import build_effect_rows, build_error_view_rows
from residual.recording import Recording
from residual.verdict.document import from_json
from tests.verdict_documents import whole_document
from warehouse.queries import open_store
from warehouse.record_commit import commit_diagnosis, commit_run
from warehouse.store_catalogue import SealedTruth

DOF = 2


def recording(seed=0, rows=50, robot="two_link", **channels):
    q, tau = np.random.default_rng(seed).normal(size=(2, rows, DOF))
    return Recording("", robot, np.arange(rows) / 100, q, tau, **channels)


def spec(seed=0, kind="fourier"):
    motion = {"kind": kind, "duration": 0.5}
    return {"robot": "two_link", "seed": seed, "trajectory": motion}


def manifest(seed=0, kind="fourier", **more):
    return {"spec": spec(seed, kind), **more}


def sealed(seed=0, rows=50):
    truth = {"q": np.full((rows, DOF), seed), "temperature": np.arange(float(rows))}
    return SealedTruth({"effects": ["stribeck"], "salt": f"s{seed}"}, truth)


def commit(store, seed=0, kind="fourier", rows=50, **more):
    log = recording(seed, rows, q_ref=np.full((rows, DOF), 0.25))
    twin = {"e_q": log.q / 10, "e_tau": log.tau / 10}
    open_half = manifest(seed, kind, **more)
    return commit_run(store, log, open_half, sealed(seed, rows), twin)


def ask(store, query, values=None):
    with open_store(store) as opened:
        return opened.sql(query, values).to_pylist()


def flip(path, at=None, bit=0):
    data = bytearray(path.read_bytes())
    data[len(data) // 2 if at is None else at] ^= 1 << bit
    path.write_bytes(data)


def verdict(logs=(), **more):
    per_joint = {"nominal": [21.0, 18.0], "identified": [9.0, 8.0], "plsr": None}
    per_joint["augmented"] = [6.0, 5.0]
    overall = {"nominal": 20.0, "identified": 8.6, "augmented": 5.6, "plsr": None}
    finding = {"probability": 0.97, "equivalent": [], "evidence": {"nats": 310.0}}
    mass = {"mass": {"value": 2.9, "std": 0.1, "unit": "kg"}}
    level = {"level": {"value": [1.5, 2.5], "std": [0.1, 0.2], "unit": "N m"}}
    part = {
        "robot": "two_link",
        "declared": ["viscous"],
        "verdict": "effects",
        "effects": [
            {"name": "payload", "joints": [2], "order": 1, "parameters": mass, **finding},
            {"name": "coulomb", "joints": [1, 2], "order": 2, "parameters": level} | finding,
            {"name": "delay", "joints": [], "order": 3, "parameters": {}, **finding},
        ],
        "unexplained": {"fraction": 0.04},
        "error": {
            "logs": list(logs),
            "held_out": per_joint,
            "filtered": per_joint,
            "moving": per_joint,
            "overall": overall,
            "overall_filtered": overall,
        },
        "nominal_scale": 0.03,
        **more,
    }
    return whole_document(part, DOF)


def store_verdict(store, document, model, runs, more=None, tables=None):
    """Put a diagnosis into the store; of a plain list the runs have their roles."""
    stored_verdict = from_json(document)
    if not isinstance(runs, dict):
        held_out = [id for id in runs if id in stored_verdict.error.logs]
        fit = [id for id in runs if id not in held_out]
        runs = {"fit": fit, "held_out": held_out}
    tables = dict(tables or {})
    errors = tables.pop("errors", None)
    record = {
        "robot": stored_verdict.robot,
        "verdict": stored_verdict.verdict,
        "nominal_scale": stored_verdict.nominal_scale,
        "unexplained": stored_verdict.unexplained.fraction,
        "document": document,
        **(more or {}),
    }
    rows = [*build_error_view_rows(stored_verdict.error), *(errors.to_pylist() if errors else ())]
    effects = list(build_effect_rows(stored_verdict.effects))
    return commit_diagnosis(store, record, model, runs, effects=effects, errors=rows, tables=tables)
