"""A calibration as one JSON document, as files, and as records of the store."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from flows.storage.diagnosis import read_known, read_models, read_verdict
from residual.calibration.calibrate import Calibration, corrected_model
from residual.calibration.scores import RUN, Score
from residual.diagnosis.result import Finding
from residual.export.c99 import tables_header, to_c99
from residual.export.exported import to_json
from residual.model.model import Model, Term
from residual.model.nominal import declared_names
from residual.model.record import to_record
from residual.robot.robot import Robot
from residual.tables.crossval import relative_error
from residual.tables.figures import CLASSES
from residual.tables.lookup import export_lookup
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
                {"joint": j, **asdict(o)}
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
    return {
        "levels": list(made.sweep.levels),
        "rmsev": {k: [_numbers(v) for v in e] for k, e in made.sweep.errors.items()},
        "seconds": [round(s, 3) for s in made.sweep.seconds],
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


def calibration_files(made: Calibration) -> dict[str, bytes]:
    """Return what a calibration is exported as, content by file name.

    Returns:
        The tables and their evaluator (`export_lookup`); where they correct a model,
        `corrected.json` with both, and both as a C header; a header of the tables alone
        where they correct a simulation.
    """
    files = export_lookup(made.lookup)
    whole = corrected_model(made)
    if whole is None:
        return files | tables_header(made.lookup, made.robot)
    (record,) = to_json(whole).files.values()
    return {**files, CORRECTED: record, **to_c99(whole).files}


def store_calibration(
    store: Path, made: Calibration, request: Mapping
) -> dict[str, str]:
    """Put the tables and the errors into the store.

    Args:
        request: What was asked for, so that it can be made again: `logs`, the ids of
            the runs it is from, in order, and `diagnosis`, whose effects it has.
    """
    ids = request["logs"]
    named = {"diagnosis": [request["diagnosis"]]} if request["diagnosis"] else {}
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
    parents = {"fit": list(ids), **named}
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
    parents = {"model": [model_id], "run": list(ids), **named}
    validation = commit_record(store, "validations", record, tables, parents)
    return {"model": model_id, "validation": validation}


@dataclass(frozen=True, eq=False, slots=True)
class Found:
    """What a diagnosis of the same runs named."""

    effects: tuple[Term, ...] = ()
    line: str | None = None
    diagnosis: str | None = None


def found_effects(
    store: Path,
    ids: Sequence[str],
    robot: Robot,
    declared: Sequence[str] | None,
) -> Found:
    """Return what the latest diagnosis of these runs named.

    It must be of these runs alone, held-out ones included or not, and of a model with
    the same declared effects.
    """
    if not ids:
        return Found()
    from warehouse.query.store import ask

    query = (
        "SELECT d.diagnosis_id AS id, l.parent AS run FROM diagnoses d JOIN lineage l "
        "ON l.child = d.diagnosis_id AND l.role = 'fit' WHERE d.verdict = 'effects' "
        "ORDER BY d.created DESC"
    )
    runs: dict[str, set[str]] = {}
    for row in ask(store, query):
        runs.setdefault(row["id"], set()).add(row["run"])
    names = sorted(declared_names(robot, declared))
    for id, fitted in runs.items():
        verdict = read_verdict(store, id)
        if fitted <= set(ids) and sorted(verdict.declared) == names:
            named = ", ".join(_words(e) for e in verdict.effects)
            line = (
                f"named effects are those of diagnosis {id[:8]} ({named}): their names "
                "come from these runs, their values are fitted without the held-out "
                "ones"
            )
            models = read_models(store, id)
            count = len(models["nominal"].terms)
            return Found(models["augmented"].terms[count:], line, id)
    return Found()


def effects_of(store: Path, diagnosis: str) -> Found:
    """Return what the model of a diagnosis has beyond the robot as described.

    Of that model only names and forms: its values may come from these very runs, and
    what is judged on a run must not have seen it.
    """
    terms = _beyond(read_known(store, diagnosis))
    named = ", ".join(f"{t.effect.name} {_joints(t)}".strip() for t in terms)
    line = (
        f"named effects are those of the model of diagnosis {diagnosis[:8]} "
        f"({named or 'none'}): their values are fitted without the held-out runs"
    )
    return Found(terms, line, diagnosis)


def _beyond(model: Model) -> tuple[Term, ...]:
    """The terms that are not those of the robot as described: these come first."""
    described: set[tuple] = set()
    beyond = []
    for term in model.terms:
        given = model.robot.declared.get(term.effect.name)
        key = term.effect.name, term.joints
        if term.effect.name not in declared_names(model.robot, None) or (
            key in described and given and given.values
        ):
            beyond.append(term)
        described.add(key)
    return tuple(t for t in beyond if len(t.theta))


def _joints(term: Term) -> str:
    return " ".join(f"J{j + 1}" for j in term.joints)


def _words(effect: Finding) -> str:
    joints = " ".join(f"J{j}" for j in effect.joints)
    return f"{effect.name} {joints}".strip()


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
