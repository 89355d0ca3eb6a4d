"""Calibrate a data-driven correction on logs or runs; store it if all are runs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter

from flows.inputs.read import LogSets, check_declared, load_run_robot, read_log_sets, require_logs
from flows.outputs import Progress
from flows.requests import Calibrate
from flows.settings import resolve_store_folder
from flows.steps.check import correct_mounting, refuse_faulty_logs
from flows.storage.calibration import store_calibration
from residual import one_blas_thread
from residual.calibration.calibrate import Calibration, CalibrationSettings
from residual.calibration.calibrate import calibrate as fit_tables
from residual.calibration.calibration_rows import CalibrationRun
from warehouse.runs import read_channels
from warehouse.store_catalogue import find_run
from warehouse.store_files import read_parquet


@dataclass(frozen=True, eq=False, slots=True)
class StoredCalibration:
    """A calibration, and where it is kept.

    Attributes:
        calibration: The calibration.
        warnings: What is odd but usable.
        stored: Ids of the records by kind; empty where nothing was stored.
    """

    calibration: Calibration
    warnings: tuple[str, ...]
    stored: Mapping[str, str]


def read_logs(request: Calibrate) -> tuple[LogSets, tuple[CalibrationRun, ...]]:
    """Read every log once: runs with their twin and family, files as they are.

    Returns:
        The logs, and the same as runs of a calibration.

    Raises:
        InputError: If the request or a log is not usable.
    """
    robot = load_run_robot(request.robot, request.logs, request.store)
    check_declared(request.declared)
    require_logs(request.logs, "to calibrate on", "calibrate")
    sets = (request.logs, (), ())
    logs = read_log_sets(sets, robot, request.columns, request.store, True, called=request.robot)
    store, runs, lines = resolve_store_folder(request.store), [], []
    for log, line in zip(logs.fit, logs.each, strict=True):
        id = logs.runs.get(log.id)
        runs.append(CalibrationRun(log, *_beside(store, id)) if id else CalibrationRun(log))
        lines.append(_about(runs[-1]) if id else line)
    return replace(logs, each=tuple(lines)), tuple(runs)


@one_blas_thread
def calibrate(
    request: Calibrate,
    logs: LogSets,
    runs: Sequence[CalibrationRun],
    progress: Progress | None = None,
    with_figures: bool = True,
) -> StoredCalibration:
    """Fit and validate every model; store what was found if all logs are runs.

    Args:
        runs: The same as runs of a calibration.
        with_figures: Whether to compute what only figures need.

    Raises:
        InputError: If the logs are not usable together, or a fault of them is certain.
    """
    store, ids = resolve_store_folder(request.store), tuple((logs.runs or {}).values())
    begun = perf_counter()
    report = refuse_faulty_logs(logs, request.trust_log)
    robot = correct_mounting(logs, report).robot
    settings = replace(_settings(request), with_figures=with_figures)
    # One thread: the products are small, two threads only wait for each other.
    made = fit_tables(robot, runs, settings, progress)
    asked = request.to_record() | {"logs": list(ids), "robot_hash": logs.robot.content_hash}
    stored = len(ids) == len(runs)
    seconds = {"calibrate": perf_counter() - begun}
    kept = store_calibration(store, made, asked, seconds) if stored else {}
    return StoredCalibration(made, (*logs.warnings, *report.sentences), kept)


def _settings(request: Calibrate) -> CalibrationSettings:
    settings = CalibrationSettings(
        paper=request.paper, declared=request.declared, joints=request.joints
    )
    form = settings.form
    if request.components is not None:
        form = replace(form, components=request.components)
    if request.levels is not None:
        one, *more = request.levels
        form = replace(form, levels=request.levels if more else one)
    return replace(settings, form=form, exact_components=request.components is not None)


def _beside(store: Path, id: str) -> tuple[str | None, dict]:
    row = read_parquet(find_run(store, id).row, ["trajectory"])
    channels = read_channels(store, id)
    twin = {name: c for name, c in channels.items() if name.startswith("e_")}
    return row.column("trajectory")[0].as_py(), twin


def _about(run: CalibrationRun) -> str:
    log, family = run.log, run.family or "unknown motion"
    return f"{log.id}: run of {log.robot}, {family}, {len(log.t)} samples, {log.duration:.2f} s"
