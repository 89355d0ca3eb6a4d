"""Find the effects that a robot model lacks, from logs or from runs of the store."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter

import numpy as np

from flows import inputs
from flows import storage as records
from flows.inputs import (
    LogSets,
    apply_known_values,
    is_run_id,
    parse_known_values,
    read_file_serial,
    read_run_robot,
    read_run_serial,
)
from flows.outputs import Progress
from flows.requests import Diagnose
from flows.settings import resolve_store_folder
from flows.steps.check import refuse_faulty_logs
from flows.steps.model_choice import choose_request_model
from residual import one_blas_thread
from residual.diagnosis import diagnose as method
from residual.drive import FACTOR
from residual.errors import InputError
from residual.recording import Recording
from residual.robot.robot import Robot
from residual.verdict.result import Diagnosis
from warehouse.store_catalogue import read_run

ROLES = {"fit": "logs", "held_out": "held_out", "baseline": "baseline"}


def read_logs(request: Diagnose, robot: Robot | None = None) -> LogSets:
    """Read every log once, and the robot where it is not loaded yet."""
    read = inputs.read_logs(request, "to diagnose", robot)
    robot, warnings = read.robot, list(read.warnings)
    for run in filter(is_run_id, request.baseline):
        serial = read_run_serial(run, request.store)
        if (serial or read_file_serial(robot)) != robot.serial:
            warnings.append(
                f"baseline run {run} is of {robot.name} {serial or 'without a number'}, not "
                f"of {robot.serial or 'an arm without a number'}: differences between the "
                "two arms count as findings"
            )
    driven = any(r.drive is not None for r in (*read.fit, *read.baseline))
    if driven and "payload.mass" not in robot.known_values:
        warnings.append(f"torque follows from the drives' gains: {FACTOR}")
    return replace(read, warnings=tuple(warnings))


@one_blas_thread
def diagnose(
    request: Diagnose,
    logs: LogSets,
    progress: Progress | None = None,
    ignore_baseline: bool = False,
) -> Diagnosis:
    """Find the missing effects, and whether an experiment would separate rivals.

    Args:
        request: Its options; its logs, baseline and robot were read into the next.
        ignore_baseline: Diagnose the logs alone although there is a baseline.
    """
    store, declared = resolve_store_folder(request.store), request.declared
    if request.model:
        declared = records.read_adoptable_model(store, request.model)
        before = logs.baseline or _behind(request.model, logs, store)
        logs = replace(logs, baseline=before)
    logs, report = refuse_faulty_logs(logs, request.trust_log)
    result = method.diagnose(
        logs.robot,
        logs.fit,
        baseline=logs.baseline,
        held_out=logs.held_out,
        declared=declared,
        progress=progress,
        ignore_baseline=ignore_baseline,
        check=report,
        warnings=logs.warnings,
    )
    return replace(result, notes=(*logs.lines, *result.notes))


def _behind(diagnosis: str, logs: LogSets, store: Path) -> tuple[Recording, ...]:
    """Return the runs behind an adopted model, except those diagnosed now."""
    known = logs.runs or {}
    now = {known.get(log.id, log.id) for log in (*logs.fit, *logs.held_out)}
    ids = records.read_runs(store, diagnosis, ("fit", "held_out"))
    ids = [id for id in ids if id not in now]
    subject = f"what changed since the model of diagnosis {diagnosis[:8]}"
    if not ids:
        raise InputError(
            f"To say {subject}, runs behind it are needed that are not diagnosed now: "
            "expected one at least, got none. Diagnose later runs, or give --model nominal."
        )
    try:
        return tuple(read_run(store, id) for id in ids)
    except InputError as error:
        # Runs are pruned, or in another store: the model keeps their motion.
        motion = tuple(m for m in records.read_motion(store, diagnosis) if m.id in ids)
        if motion:
            return motion
        raise InputError(
            f"To find {subject}, its runs are needed: expected "
            f"{', '.join(id[:8] for id in ids)} in {store}. Got: {error} Import them "
            "into this store, or give logs of that time with --baseline."
        ) from error


def read_stored_runs(request: Diagnose) -> LogSets:
    """Read complete runs of the store, as the command does, and nothing else."""
    return resolve_whole_runs(read_logs(request))


def diagnose_stored_runs(request: Diagnose, progress: Progress | None = None) -> tuple[str, str]:
    """Diagnose runs of the store and store the verdict.

    Nothing but the runs is read, so the verdict is the same without `sealed/`.

    Returns:
        The ids of the diagnosis, and of the validation that has its curves.
    """
    logs, begun = read_stored_runs(request), perf_counter()
    result = diagnose(request, logs, progress)
    return store_diagnosis(request, logs, result, perf_counter() - begun)


def diagnose_recordings(
    request: Diagnose, logs: LogSets, progress: Progress | None = None
) -> tuple[Diagnosis, str | None]:
    """Diagnose recordings that are in memory; where the request has a store, its runs.

    Runs are diagnosed as by the command: against the adopted model of the robot, and
    the diagnosis is stored.

    Returns:
        The diagnosis, and its id in the store; None where it is not stored.
    """
    if request.store is None:
        known = parse_known_values(request.known)
        logs = replace(logs, robot=apply_known_values(logs.robot, known, logs.baseline))
        return diagnose(request, logs, progress), None
    ids = {
        role: tuple(_find_run(log, request.store) for log in getattr(logs, role)) for role in ROLES
    }
    request = add_stored_runs(request, ids)
    request = replace(request, model=choose_request_model(request, logs.robot).diagnosis)
    read, begun = read_stored_runs(request), perf_counter()
    result = diagnose(request, read, progress)
    return result, store_diagnosis(request, read, result, perf_counter() - begun)[0]


def _find_run(log: Recording, store: Path) -> str:
    """Return the id of the run of a recording; InputError if it is no run."""
    if is_run_id(log.id):
        run = read_run(store, log.id)
        if np.array_equal(run.t, log.t) and np.array_equal(run.tau, log.tau):
            return run.id
    raise InputError(
        f"{log.id} is no complete run of {store}, expected runs of the store. Store its "
        "file with mg.import_logs, then read the id with mg.read_logs; or give no store."
    )


def store_diagnosis(
    request: Diagnose, logs: LogSets, result: Diagnosis, seconds: float
) -> tuple[str, str]:
    """Store a diagnosis of runs; an equal one of the same runs is stored once.

    Args:
        logs: The runs, called by their whole ids (`resolve_whole_runs`).
        seconds: Time that the diagnosis took [s].
    """
    ids = {role: [log.id for log in getattr(logs, role)] for role in ROLES}
    words = {name: tuple(ids[role]) for role, name in ROLES.items()}
    record = replace(request, **words).to_record()
    parents = {role: names for role, names in ids.items() if names}
    hash = {"robot_hash": logs.robot.content_hash}
    store, record = resolve_store_folder(request.store), record | hash
    return records.store_outcome(
        store,
        result,
        parents,
        record,
        (*logs.fit, *logs.held_out),
        {"diagnose": seconds},
        logs.robot.serial,
    )


def resolve_whole_runs(logs: LogSets) -> LogSets | None:
    """Return logs by the whole ids of their runs; None unless all are whole runs."""
    parts = {role: getattr(logs, role) for role in ROLES}
    if any(log.id not in (logs.runs or {}) for part in parts.values() for log in part):
        return None
    named = {
        role: tuple(replace(log, id=logs.runs[log.id]) for log in part)
        for role, part in parts.items()
    }
    return replace(logs, **named)


def build_diagnose_request(
    runs: Mapping[str, Sequence[str]], store: Path, model: str | None = None
) -> Diagnose:
    """Return the request to diagnose runs of one robot, given by role: fit, held_out, baseline."""
    return add_stored_runs(Diagnose(robot="", store=store, model=model), runs)


def add_stored_runs(request: Diagnose, runs: Mapping[str, Sequence[str]]) -> Diagnose:
    """Return a request with ids of runs by role, and their robot."""
    words = {name: tuple(runs.get(role, ())) for role, name in ROLES.items()}
    return replace(request, robot=read_run_robot(runs["fit"], request.store), **words)
