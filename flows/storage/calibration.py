"""Write a calibration as a JSON document, as files, and as records of the store."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from residual.calibration.calibrate import Calibration, build_corrected_model
from residual.calibration.validation_scores import RUN, ModelScore, compute_relative_error
from residual.export.c99 import to_c99
from residual.export.model_export import to_json
from residual.model.lookup import build_lookup_files
from warehouse.record_commit import commit_record
from warehouse.view_schema import build_view_table

STAGE, KIND, CORRECTED = "calibrated", "calibration", "corrected.json"


def build_calibration_document(
    calibration: Calibration, words: Sequence[str], warnings: Sequence[str], kept: Mapping[str, str]
) -> dict:
    """Return all figures of a calibration; what is not known is null."""
    rows, sweep = calibration.rows, calibration.sweep
    sizes = [len(axis.edges) + 1 for axis in calibration.paper.axes]
    options = zip(rows.joints, calibration.chosen, strict=True)
    return {
        "schema": 1,
        "robot": calibration.robot,
        "mode": rows.mode,
        "declared": list(calibration.declared),
        "logs": list(rows.labels),
        "families": [f or None for f in rows.families],
        "rows": len(rows.X),
        "joints": list(rows.joints),
        "variables": list(calibration.lookup.names),
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
            for score in calibration.scores
        ],
        "default": {
            "proven": calibration.proven,
            "options": [{"joint": j, **asdict(o)} for j, o in options],
        },
        "paper_form": {
            "levels": dict(zip(rows.names, sizes, strict=True)),
            "components": calibration.components,
        },
        "components": [
            {
                "family": block.family,
                "block": block.block,
                "explained": _numbers(block.explained),
                "surrogate_limit": _numbers(block.limit),
                "real": block.real,
                "first": [[key, round(x, 4)] for key, x in block.strongest(0)],
            }
            for block in calibration.blocks
        ],
        "levels": sweep
        and {
            "levels": list(sweep.levels),
            "rmsev": {k: [_numbers(v) for v in e] for k, e in sweep.errors.items()},
            "seconds": [round(s, 3) for s in sweep.seconds],
        },
        "words": list(words),
        "notes": list(calibration.notes),
        "warnings": list(warnings),
        "stored": dict(kept) or None,
    }


def _numbers(values: Iterable[float]) -> list[float | None]:
    return [
        round(value, 6) if math.isfinite(value) else None
        for value in np.asarray(values, dtype=float).tolist()
    ]


def build_calibration_files(calibration: Calibration) -> dict[str, bytes]:
    """Return what a calibration is exported as, content by file name.

    Returns:
        The tables and their evaluator (`build_lookup_files`); where they correct a
        model, `corrected.json` with both, and both as a C header.
    """
    files = build_lookup_files(calibration.lookup)
    whole = build_corrected_model(calibration)
    if whole is None:
        return files
    (record,) = to_json(whole).files.values()
    return {**files, CORRECTED: record, **to_c99(whole).files}


def store_calibration(
    store: Path, calibration: Calibration, request: Mapping, seconds: Mapping[str, float]
) -> dict[str, str]:
    """Put the tables and the errors into the store.

    Args:
        request: What was asked for, so that it can be made again: `logs`, the ids of
            the runs it is from, in order.
    """
    ids = request["logs"]
    model = {
        "robot": calibration.robot,
        "stage": STAGE,
        "request": request,
        "mode": calibration.rows.mode,
        "declared": list(calibration.declared),
        # None for the simulated twin.
        "nominal": None if calibration.nominal is None else calibration.nominal.to_record(),
        "options": [asdict(o) for o in calibration.chosen],
        "variables": list(calibration.lookup.names),
        "joints": list(calibration.rows.joints),
    }
    parents = {"fit": list(ids)}
    files = build_calibration_files(calibration)
    model_id = commit_record(store, "models", model, parents=parents, files=files)
    record = {
        "robot": calibration.robot,
        "kind": KIND,
        "model_id": model_id,
        "request": request,
        "mode": calibration.rows.mode,
        "notes": list(calibration.notes),
    }
    rows = [row for score in calibration.scores for row in _rows(score, ids)]
    finite = [row for row in rows if row["value"] == row["value"]]  # no NaN
    tables = {"errors": build_view_table("errors", finite)}
    parents = {"model": [model_id], "run": list(ids)}
    validation = commit_record(store, "validations", record, tables, parents, seconds=seconds)
    return {"model": model_id, "validation": validation}


def _rows(score: ModelScore, ids: Sequence[str]) -> Iterator[dict]:
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
    for id, values in zip(ids, compute_relative_error(score.miss, score.power), strict=True):
        for joint, value in enumerate(values, 1):
            row_of_run = {**same, "run_id": id, "joint": joint}
            yield {**row_of_run, "metric": metric, "value": float(value)}
