"""A calibration as one JSON document, as files, and as records of the store."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from residual.calibration.calibrate import Calibration, corrected_model
from residual.calibration.crossval import relative_error
from residual.calibration.scores import RUN, Score
from residual.export.c99 import to_c99
from residual.export.export import to_json
from residual.model.lookup import export_lookup
from residual.model.record import to_record
from warehouse.commit import commit_record
from warehouse.schema import rows_table

STAGE, KIND, CORRECTED = "calibrated", "calibration", "corrected.json"


def document(
    made: Calibration,
    words: Sequence[str],
    warnings: Sequence[str],
    kept: Mapping[str, str],
) -> dict:
    """Return all figures of a calibration; what is not known is null."""
    rows, sweep = made.rows, made.sweep
    sizes = [len(axis.edges) + 1 for axis in made.paper.axes]
    options = zip(rows.joints, made.chosen, strict=True)
    return {
        "schema": 1,
        "robot": made.robot,
        "mode": rows.mode,
        "declared": list(made.declared),
        "logs": list(rows.labels),
        "families": [f or None for f in rows.families],
        "rows": len(rows.X),
        "joints": list(rows.joints),
        "variables": list(made.lookup.names),
        "metric": "100*||tau-tau_hat||/||tau||",
        "table": [
            {
                "scheme": score.scheme,
                "model": score.model,
                "components": score.components,
                "rmsec": _numbers(score.rmsec),
                "rmsev": _numbers(score.rmsev),
                "rmsev_mean_of_subsets": _numbers(score.mean),
                "overall": _numbers([score.overall])[0],
            }
            for score in made.scores
        ],
        "default": {
            "proven": made.proven,
            "options": [{"joint": j, **asdict(o)} for j, o in options],
        },
        "paper_form": {
            "levels": dict(zip(rows.names, sizes, strict=True)),
            "components": made.components,
        },
        "components": [
            {
                "family": block.family,
                "block": block.block,
                "explained": _numbers(block.explained),
                "surrogate_limit": _numbers(block.limit),
                "real": block.pca.real,
                "first": [[key, round(x, 4)] for key, x in block.pca.strongest(0)],
            }
            for block in made.blocks
        ],
        "levels": sweep
        and {
            "levels": list(sweep.levels),
            "rmsev": {k: [_numbers(v) for v in e] for k, e in sweep.errors.items()},
            "seconds": [round(s, 3) for s in sweep.seconds],
        },
        "words": list(words),
        "notes": list(made.notes),
        "warnings": list(warnings),
        "stored": dict(kept) or None,
    }


def _numbers(values: Iterable[float]) -> list[float | None]:
    return [
        round(value, 6) if math.isfinite(value) else None
        for value in np.asarray(values, dtype=float).tolist()
    ]


def calibration_files(made: Calibration) -> dict[str, bytes]:
    """Return what a calibration is exported as, content by file name.

    Returns:
        The tables and their evaluator (`export_lookup`); where they correct a model,
        `corrected.json` with both, and both as a C header.
    """
    files = export_lookup(made.lookup)
    whole = corrected_model(made)
    if whole is None:
        return files
    (record,) = to_json(whole).files.values()
    return {**files, CORRECTED: record, **to_c99(whole).files}


def store_calibration(
    store: Path, made: Calibration, request: Mapping
) -> dict[str, str]:
    """Put the tables and the errors into the store.

    Args:
        request: What was asked for, so that it can be made again: `logs`, the ids of
            the runs it is from, in order.
    """
    ids = request["logs"]
    model = {
        "robot": made.robot,
        "stage": STAGE,
        "request": request,
        "mode": made.rows.mode,
        "declared": list(made.declared),
        # None for the simulated twin.
        "nominal": None if made.nominal is None else to_record(made.nominal),
        "options": [asdict(o) for o in made.chosen],
        "variables": list(made.lookup.names),
        "joints": list(made.rows.joints),
    }
    parents = {"fit": list(ids)}
    files = calibration_files(made)
    model_id = commit_record(store, "models", model, parents=parents, files=files)
    record = {
        "robot": made.robot,
        "kind": KIND,
        "model_id": model_id,
        "request": request,
        "mode": made.rows.mode,
        "notes": list(made.notes),
    }
    rows = [row for score in made.scores for row in _rows(score, ids)]
    known = [row for row in rows if row["value"] == row["value"]]  # no NaN
    tables = {"errors": rows_table("errors", known)}
    parents = {"model": [model_id], "run": list(ids)}
    validation = commit_record(store, "validations", record, tables, parents)
    return {"model": model_id, "validation": validation}


def _rows(score: Score, ids: Sequence[str]) -> Iterator[dict]:
    same = {"run_id": None, "trajectory": None, "stage": score.model}
    figures = {"rmsec": score.rmsec, "rmsev": score.rmsev, "rmsev_mean": score.mean}
    for name, values in figures.items():
        metric = f"{name}_{score.scheme}"
        for joint, value in enumerate(values, 1):
            yield {**same, "joint": joint, "metric": metric, "value": float(value)}
    metric = f"rmsev_{score.scheme}"
    yield {**same, "joint": None, "metric": metric, "value": score.overall}
    if score.scheme != RUN or len(ids) != len(score.miss):
        return
    for id, values in zip(ids, relative_error(score.miss, score.power), strict=True):
        for joint, value in enumerate(values, 1):
            own = {**same, "run_id": id, "joint": joint}
            yield {**own, "metric": metric, "value": float(value)}
