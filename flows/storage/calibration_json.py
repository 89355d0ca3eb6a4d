"""A calibration as one JSON document."""

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from residual.calibration.calibrate import Calibration, corrected_model
from residual.export.c99 import to_c99
from residual.export.exported import to_json
from residual.export.numpy_file import to_numpy
from residual.tables.lookup import export_lookup
from residual.tables.outliers import CLASSES


def document(
    made: Calibration,
    words: Sequence[str],
    warnings: Sequence[str],
    kept: Mapping[str, str],
) -> dict:
    """Return all figures of a calibration; what is not known is null.

    Args:
        made: The calibration.
        kept: Ids of its records by kind; empty where nothing was stored.
    """
    return {
        "schema": 1,
        "robot": made.robot,
        "mode": made.rows.mode,
        "declared": list(made.declared),
        "logs": list(made.rows.labels),
        "families": [f or None for f in made.rows.families],
        "rows": len(made.rows.X),
        "joints": list(made.rows.joints),
        "variables": list(made.lookup.names),
        "metric": "100*||tau-tau_hat||/||tau||",
        "table": [_score(one) for one in made.scores],
        "default": {
            "proven": made.proven,
            "options": [
                {"joint": j, "kind": o.kind, "ridge": o.ridge, "count": o.count}
                for j, o in zip(made.rows.joints, made.chosen, strict=True)
            ],
        },
        "paper_form": _levels(made),
        "components": [_components(one) for one in made.components],
        "levels": _sweep(made),
        "importance": _terms(made),
        "outliers": _oddities(made),
        "plane": _plane(made),
        "words": list(words),
        "notes": list(made.notes),
        "warnings": list(warnings),
        "stored": dict(kept) or None,
    }


def _levels(made: Calibration) -> dict | None:
    """Levels and components that were chosen for the paper's form."""
    if made.levels is None:
        return None
    form, names = made.levels.form, made.rows.names
    return {
        "levels": dict(zip(names, form.levels, strict=True)),
        "components": made.levels.components,
        "common": made.levels.common,
    }


def _score(one) -> dict:
    return {
        "scheme": one.scheme,
        "model": one.model,
        "components": one.components,
        "rmsec": _numbers(one.rmsec),
        "rmsev": _numbers(one.rmsev),
        "rmsev_mean_of_subsets": _numbers(one.mean),
        "overall": _number(one.overall),
    }


def _components(one) -> dict:
    return {
        "family": one.family,
        "block": one.block,
        "explained": _numbers(one.explained),
        "surrogate_limit": _numbers(one.limit),
        "real": one.real,
        "real_by_permutation": one.permuted,
        "first": [[name, round(value, 4)] for name, value in one.first],
    }


def _sweep(made: Calibration) -> dict | None:
    if made.sweep is None:
        return None
    errors = {k: [_numbers(v) for v in e] for k, e in made.sweep.errors.items()}
    seconds = [round(s, 3) for s in made.sweep.seconds]
    return {
        "levels": list(made.sweep.levels),
        "rmsev": errors,
        "seconds": seconds,
        "megabytes": [round(m, 3) for m in made.sweep.megabytes],
    }


def _terms(made: Calibration) -> list[dict] | None:
    if made.terms is None:
        return None
    sizes, by_rows = made.terms.sizes, made.terms.by_rows
    keys = ("term", "size", "error", "error_over_rows")
    columns = (sizes.values, sizes.errors, by_rows.errors)
    return [
        dict(zip(keys, (name, *map(_numbers, row)), strict=True))
        for name, *row in zip(made.terms.names, *columns, strict=True)
    ]


def _plane(made: Calibration) -> dict | None:
    """Loadings of PLSR as correlations with its first two scores."""
    plane = made.plane
    if plane is None:
        return None
    pairs = zip(plane.names, plane.loadings, strict=True)
    return {
        "explained": _numbers(plane.explained),
        "loadings": {name: _numbers(values) for name, values in pairs},
    }


def _oddities(made: Calibration) -> list[dict] | None:
    odd = made.oddities
    if odd is None:
        return None
    keys = ("log", "x_outliers", "y_outliers", "unvisited_cells", "outside_range")
    columns = (odd.labels, odd.x, odd.y, odd.unvisited, odd.outside)
    by_class = [dict(zip(CLASSES, shares, strict=True)) for shares in odd.by_class]
    return [
        {**dict(zip(keys, row, strict=True)), "y_by_speed": shares}
        for row, shares in zip(zip(*columns, strict=True), by_class, strict=True)
    ]


def _numbers(values: Iterable[float]) -> list[float | None]:
    return [_number(v) for v in np.asarray(values).tolist()]


def _number(value: float) -> float | None:
    return round(value, 6) if math.isfinite(value) else None


CORRECTED = "corrected.json"


def calibration_files(made: Calibration) -> dict[str, bytes]:
    """Return what a calibration is exported as, content by file name.

    Args:
        made: The calibration.

    Returns:
        The tables and their evaluator (`export_lookup`); where they correct a model,
        `corrected.json` with both, and both as a file for NumPy and as a C header.
    """
    files = export_lookup(made.lookup)
    whole = corrected_model(made)
    if whole is None:
        return files
    (record,) = to_json(whole).files.values()
    both = {**to_numpy(whole).files, **to_c99(whole).files}
    return {**files, CORRECTED: record, **both}
