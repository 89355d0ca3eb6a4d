"""Identify or calibrate a model from logs or runs; store it if all are runs.

A result is also a JSON document and, of a calibration, a folder of files.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import perf_counter

import numpy as np

from flows.inputs import LogSets, is_run_id, read_logs
from flows.outputs import Progress
from flows.requests import Calibrate, Identify
from flows.settings import resolve_store_folder
from flows.steps.check import refuse_faulty_logs
from flows.steps.model_choice import read_model
from flows.storage import CORRECTED, read_adoptable_model
from residual import one_blas_thread
from residual.calibration.calibrate import (
    Calibration,
    CalibrationSettings,
    add_correction_tables,
    build_corrected_model,
)
from residual.calibration.calibrate import calibrate as fit_tables
from residual.calibration.calibration_rows import PAPER, CalibrationRun
from residual.calibration.validation_scores import RUN, ModelScore, compute_relative_error
from residual.errors import InputError
from residual.export.c99 import to_c99
from residual.export.model_export import AnyModel, remove_tables, to_json
from residual.identification.estimate import Options
from residual.identification.identify import ValidatedIdentification, identify_and_validate
from residual.model.lookup import Lookup, build_lookup_files
from residual.model.model import Model
from residual.quantity import convert_to_plain_values
from residual.robot.robot import Robot
from warehouse.record_commit import commit_record
from warehouse.store_catalogue import find_record, find_run, read_channels, read_record
from warehouse.store_files import read_row_text
from warehouse.view_schema import build_view_table

SCHEMA, IDENTIFIED = 1, "identified"
KINDS = ("raw", "filtered", "moving")


def build_identification_document(outcome: ValidatedIdentification) -> dict:
    """Return an outcome as plain values: every key always there, null for none."""
    found, estimate = outcome.free, outcome.free.estimate
    consistent = outcome.consistent
    return convert_to_plain_values(
        {
            "schema": SCHEMA,
            "robot": outcome.robot.name,
            "declared": list(dict.fromkeys(t.effect.name for t in found.nominal.terms)),
            "method": found.options.method,
            "prior": found.options.prior,
            "logs": outcome.fit,
            "held_out": outcome.held_out,
            "same_run": outcome.same_run,
            "condition": estimate.condition,
            "noise": estimate.noise,
            "rows": estimate.counts,
            "independent_rows": estimate.independent_rows,
            "outliers": estimate.outliers,
            "parameters": build_parameter_rows(outcome),
            "error": {
                "metric": "100*||tau-tau_hat||/||tau||",
                **{
                    kind: {
                        name: {"joints": e.per_joint(kind), "overall": e.overall(kind)}
                        for name, e in outcome.errors.items()
                    }
                    for kind in KINDS
                },
            },
            "acceleration_error": {
                name: made
                and {"joints": made.per_joint("moving"), "overall": made.overall("moving")}
                for name, made in outcome.accelerations.items()
            },
            "least_mass_matrix": outcome.least_mass_matrix,
            "consistent": consistent
            and {
                "masses": consistent.model.inertial[::10],
                "least_eigenvalue": consistent.least_eigenvalue,
                "poses": consistent.poses,
                "misfit": dict(zip(("identified", "consistent"), consistent.misfit, strict=True)),
            },
            "warnings": outcome.warnings,
        }
    )


def build_parameter_rows(outcome: ValidatedIdentification) -> list[dict]:
    """Return the base parameters: value, standard deviation, definition."""
    found, estimate, other = outcome.free, outcome.free.estimate, outcome.consistent
    consistent = other and found.base.mapping @ other.model.coefficients()
    rows = []
    for i, lead in enumerate(found.base.leading):
        fitted = found.status[i] == "fitted"
        row = {
            "name": lead.name,
            "joint": lead.joint,
            "unit": lead.unit,
            "is": found.base.words(i),
            "nominal": found.nominal_theta[i],
            "value": estimate.theta[i],
            "sd": estimate.sd[i] if fitted else None,
            "relative_sd": estimate.relative_sd[i] if fitted else None,
            "status": found.status[i],
            "consistent": None if consistent is None else consistent[i],
        }
        rows.append(convert_to_plain_values(row))
    return rows


def read_identification_logs(request: Identify, robot: Robot | None = None) -> LogSets:
    """Read every log once, and the robot where it is not loaded yet."""
    Options(request.method, request.prior)  # wrong ones are refused first
    return read_logs(request, "to identify from", robot)


@one_blas_thread
def identify(request: Identify, logs: LogSets) -> tuple[ValidatedIdentification, str | None]:
    """Identify, validate, and store the model if it is from runs or a store is named.

    Returns:
        The identification, and the id of the model; None where it is not stored.
    """
    known, begun = request.declared, perf_counter()
    if request.model:
        known = read_adoptable_model(resolve_store_folder(request.store), request.model)
    logs, report = refuse_faulty_logs(logs, request.trust_log)
    options = Options(request.method, request.prior)
    result = identify_and_validate(
        logs.robot, logs.fit, logs.held_out, known, options, request.consistent
    )
    warnings = (*logs.warnings, *report.sentences, *result.warnings)
    result, runs = replace(result, warnings=warnings), logs.runs or {}
    if request.store is None and len(runs) < len(logs.fit) + len(logs.held_out):
        return result, None
    seconds = {"identify": perf_counter() - begun}
    return result, _store_identification(result, request, runs, seconds)


def _store_identification(
    result: ValidatedIdentification,
    request: Identify,
    runs: Mapping[str, str],
    seconds: Mapping[str, float],
) -> str:
    """Put an identified model into the store; the same of the same runs has the same id."""
    # A held-out part of a fitted run is no separate run.
    roles = {"fit": result.fit, "held_out": () if result.same_run else result.held_out}
    by_role = {role: [runs[i] for i in ids if i in runs] for role, ids in roles.items()}
    if request.model:
        by_role["nominal"] = [request.model]
    figures = build_identification_document(result)
    record = {
        "robot": result.robot.name,
        "stage": IDENTIFIED,
        "request": request.to_record()
        | {
            "logs": [_whole(word, runs) for word in request.logs],
            "held_out": [_whole(word, runs) for word in request.held_out],
            "robot_hash": result.robot.content_hash,
        },
        "document": figures,
        "model": result.free.model.to_record(),
    }
    held_out = by_role["held_out"] or by_role["fit"]
    one = held_out[0] if len(held_out) == 1 and not result.same_run else None
    errors = [
        {"run_id": one, "stage": stage, "metric": metric, "joint": joint, "value": value}
        for kind, metric in zip(KINDS, ("held_out", *KINDS[1:]), strict=True)
        for stage, error in figures["error"][kind].items()
        for joint, value in (*enumerate(error["joints"], 1), (None, error["overall"]))
        if value is not None
    ]
    parameters = [{**row, "std": row["sd"]} for row in figures["parameters"]]
    tables = {
        "parameters": build_view_table("parameters", parameters),
        "errors": build_view_table("errors", errors),
    }
    store = resolve_store_folder(request.store)
    return commit_record(store, "models", record, tables, by_role, seconds=seconds)


def _whole(word: str, runs: Mapping[str, str]) -> str:
    """The complete id of a run; of a file its name without its folder."""
    found = [id for id in runs.values() if is_run_id(word) and id.startswith(word)]
    return found[0] if found else Path(word).name


KIND, CALIBRATED = "calibration", "calibrated"


def build_calibration_document(
    calibration: Calibration, words: Sequence[str], warnings: Sequence[str], kept: Mapping[str, str]
) -> dict:
    """Return all figures of a calibration; unknown ones are null."""
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
    """Return the exported files of a calibration, content by file name.

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
        request: The request, to make the record again: `logs` has the ids of its runs,
            in order.
    """
    ids = request["logs"]
    model = {
        "robot": calibration.robot,
        "stage": CALIBRATED,
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


@dataclass(frozen=True, eq=False, slots=True)
class StoredCalibration:
    """A calibration, and its records.

    Attributes:
        calibration: The calibration.
        warnings: Warnings about odd but usable logs.
        stored: Ids of the records by kind; empty where nothing was stored.
    """

    calibration: Calibration
    warnings: tuple[str, ...]
    stored: Mapping[str, str]


def read_calibration_runs(request: Calibrate) -> tuple[LogSets, tuple[CalibrationRun, ...]]:
    """Read every log once: runs with their twin and family, files as they are."""
    logs = read_logs(request, "to calibrate on")
    store, runs, lines = resolve_store_folder(request.store), [], []
    for log, line in zip(logs.fit, logs.each, strict=True):
        family, twin = None, {}
        if id := logs.runs.get(log.id):
            family = read_row_text(find_run(store, id).row, "trajectory")
            channels = read_channels(store, id)
            twin = {name: c for name, c in channels.items() if name.startswith("e_")}
            size = f"{len(log.t)} samples, {log.duration:.2f} s"
            line = f"{log.id}: run of {log.robot}, {family or 'unknown motion'}, {size}"
        runs.append(CalibrationRun(log, family, twin))
        lines.append(line)
    return replace(logs, each=tuple(lines)), tuple(runs)


@one_blas_thread
def calibrate(
    request: Calibrate,
    logs: LogSets,
    runs: Sequence[CalibrationRun],
    progress: Progress | None = None,
    with_figures: bool = True,
) -> StoredCalibration:
    """Fit and validate every model; store what was found if all logs are runs."""
    store, ids = resolve_store_folder(request.store), tuple((logs.runs or {}).values())
    begun = perf_counter()
    mounted, report = refuse_faulty_logs(logs, request.trust_log)
    settings = CalibrationSettings(
        paper=request.paper,
        declared=request.declared,
        joints=request.joints,
        exact_components=request.components is not None,
        with_figures=with_figures,
    )
    form = settings.form
    if request.components is not None:
        form = replace(form, components=request.components)
    if request.levels is not None:
        one, *more = request.levels
        form = replace(form, levels=request.levels if more else one)
    made = fit_tables(mounted.robot, runs, replace(settings, form=form), progress)
    asked = request.to_record() | {"logs": list(ids), "robot_hash": logs.robot.content_hash}
    stored = len(ids) == len(runs)
    seconds = {"calibrate": perf_counter() - begun}
    kept = store_calibration(store, made, asked, seconds) if stored else {}
    return StoredCalibration(made, (*logs.warnings, *report.sentences), kept)


def read_controller_model(
    store: Path, word: str, robot: Robot, nominal: Model | None = None
) -> AnyModel:
    """Return the model of a controller.

    Args:
        word: Id of a diagnosis (its augmented model, tables included), of a model, or
            of a calibration (its look-up tables on the model that they correct).
        nominal: The robot as described, for tables of the paper's form: they correct a
            simulated twin.

    Raises:
        InputError: If it is of another robot, or of another description of it.
    """
    found = find_record(store, word)
    record = read_record(store, found.id)
    if nominal and found.kind == "models" and record.get("mode") == PAPER:
        own, hash = record["robot"], record["request"]["robot_hash"]
        lookup = Lookup.load(found.folder / "model.npz")
        model: AnyModel = add_correction_tables(nominal, lookup, record["joints"])
    else:
        diagnosis = found.kind == "diagnoses"
        model = (read_adoptable_model if diagnosis else read_model)(store, found.id)
        of = remove_tables(model).robot
        own, hash = of.name, of.content_hash
    if hash != robot.content_hash:
        raise InputError(
            f"The model of {word} is of {own} as described then, the robot is "
            f"{robot.name} as described now. Give a model of this robot."
        )
    return model
