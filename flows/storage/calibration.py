"""A calibration as records of the store: the tables, and the errors they leave."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa

import warehouse
from flows.storage.calibration_json import calibration_files
from flows.storage.diagnosis import read_known, read_models, read_verdict
from residual.calibration.calibrate import Calibration
from residual.calibration.scores import RUN, Score
from residual.diagnosis.result import Finding
from residual.model.model import Model
from residual.model.nominal import declared_names
from residual.model.record import to_record
from residual.model.term import Term
from residual.robot.robot import Robot
from residual.tables.crossval import relative_error
from warehouse.commit import commit_record
from warehouse.schema import VIEWS, arrow_schema

STAGE, KIND = "calibrated", "calibration"


def store_calibration(
    store: Path, made: Calibration, request: Mapping
) -> dict[str, str]:
    """Put the tables and the errors into the store.

    Args:
        made: The calibration.
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
        "nominal": _nominal(made),
        "options": [_option(o) for o in made.chosen],
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
    tables = {"errors": errors_table(made, ids)}
    parents = {"model": [model_id], "run": list(ids), **named}
    validation = commit_record(store, "validations", record, tables, parents)
    return {"model": model_id, "validation": validation}


def errors_table(made: Calibration, ids: Sequence[str]) -> pa.Table:
    """Return all errors as rows of the view errors, metrics as rmsev_random."""
    rows = [row for score in made.scores for row in _rows(score, ids)]
    rows = [row for row in rows if row["value"] == row["value"]]  # no NaN
    return pa.Table.from_pylist(rows, schema=arrow_schema(VIEWS["errors"][1:]))


@dataclass(frozen=True, eq=False, slots=True)
class Found:
    """What a diagnosis of the same runs named.

    Attributes:
        effects: The terms that it added to the model; their coefficients are fitted
            anew.
        line: A line about it, None for no diagnosis.
        diagnosis: Its id.
    """

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

    Args:
        declared: Effects that the model has; None for the robot's own list.
    """
    if not ids:
        return Found()
    query = (
        "SELECT d.diagnosis_id AS id, l.parent AS run FROM diagnoses d JOIN lineage l "
        "ON l.child = d.diagnosis_id AND l.role = 'fit' WHERE d.verdict = 'effects' "
        "ORDER BY d.created DESC"
    )
    with warehouse.open(store) as opened:
        found = opened.sql(query).to_pylist()
    runs: dict[str, set[str]] = {}
    for row in found:
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

    Raises:
        InputError: If there is none.
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


def _nominal(made: Calibration) -> dict | None:
    """The model that the tables are a correction of; None for the simulated twin."""
    if made.nominal is None:
        return None
    return to_record(made.nominal)


def _option(option) -> dict:
    return {"kind": option.kind, "ridge": option.ridge, "count": option.count}


def _rows(score: Score, ids: Sequence[str]) -> Iterator[dict]:
    same = {"run_id": None, "trajectory": None, "stage": score.model}
    figures = (
        ("rmsec", score.rmsec),
        ("rmsev", score.rmsev),
        ("rmsev_mean", score.mean),
    )
    for name, values in figures:
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
