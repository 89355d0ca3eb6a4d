"""Identify the model of a robot from logs or runs; store it if all are runs."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from time import perf_counter

from flows.inputs import read as inputs
from flows.inputs.read import LogSets, is_run_id
from flows.requests import Identify
from flows.settings import resolve_store_folder
from flows.steps.check import correct_mounting, refuse_faulty_logs
from flows.storage.diagnosis import read_adoptable_model
from flows.storage.identification_record import store_identification
from residual import one_blas_thread
from residual.identification.estimate import Options
from residual.identification.identify import ValidatedIdentification, identify_and_validate
from residual.robot.robot import Robot


def read_logs(request: Identify, robot: Robot | None = None) -> LogSets:
    """Read every log once, and the robot where it is not loaded yet."""
    _options(request)
    return inputs.read_logs(request, "to identify from", robot)


@one_blas_thread
def identify(request: Identify, logs: LogSets) -> tuple[ValidatedIdentification, str | None]:
    """Identify, prove it, and keep the model if it is from runs or a store was named.

    Returns:
        What was identified, and the id of the model; None where it is not stored.
    """
    known, begun = request.declared, perf_counter()
    if request.model:
        known = read_adoptable_model(resolve_store_folder(request.store), request.model)
    report = refuse_faulty_logs(logs, request.trust_log)
    logs = correct_mounting(logs, report)
    result = identify_and_validate(
        logs.robot, logs.fit, logs.held_out, known, _options(request), request.consistent
    )
    warnings = (*logs.warnings, *report.sentences, *result.warnings)
    result, runs = replace(result, warnings=warnings), logs.runs or {}
    if request.store is None and len(runs) < len(logs.fit) + len(logs.held_out):
        return result, None
    seconds = {"identify": perf_counter() - begun}
    return result, _keep(result, request, runs, seconds)


def _options(request: Identify) -> Options:
    return Options(request.method, request.prior)


def _keep(
    result: ValidatedIdentification,
    request: Identify,
    runs: Mapping[str, str],
    seconds: Mapping[str, float],
) -> str:
    # A held-out part of a fitted run is no run of its own.
    roles = {"fit": result.fit, "held_out": () if result.same_run else result.held_out}
    by_role = {role: [runs[i] for i in ids if i in runs] for role, ids in roles.items()}
    if request.model:
        by_role["nominal"] = [request.model]
    record = request.to_record() | {
        "logs": [_whole(word, runs) for word in request.logs],
        "held_out": [_whole(word, runs) for word in request.held_out],
        "robot_hash": result.robot.content_hash,
    }
    return store_identification(
        resolve_store_folder(request.store), result, record, by_role, seconds
    )


def _whole(word: str, runs: Mapping[str, str]) -> str:
    """The whole id of a run; of a file its name, not where it lies."""
    found = [id for id in runs.values() if is_run_id(word) and id.startswith(word)]
    return found[0] if found else Path(word).name
