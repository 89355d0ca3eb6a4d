"""modelgap identify and calibrate: what is fitted to logs."""

from dataclasses import replace
from pathlib import Path

from flows.cli.app import Outputs
from flows.inputs.read import chosen, load_for
from flows.outputs import check_new_folder, in_folder, progress_bar, read_files
from flows.report.console import show, wide
from flows.report.models import identification as identified
from flows.report.words.calibration import sentences
from flows.requests import (
    Calibrate,
    File,
    Folder,
    HeldOutWhere,
    Identify,
    Json,
    Log,
    Where,
)
from flows.steps import calibrate as calibration
from flows.steps import identify as identification
from flows.steps.models import choose_for
from flows.storage.calibration import calibration_files
from flows.storage.calibration import document as calibration_document
from flows.storage.identification import document as identification_document
from residual.model.record import robot_files


def identify(
    *logs: Log,
    request: Identify,
    where: Where = None,
    held_out_where: HeldOutWhere = None,
    export: Folder = None,
    json: Json = None,
) -> None:
    """Identify the parameters of a robot's model.

    Base inertial parameters and declared effects are fitted together, with standard
    deviations; what the motion cannot tell is said. Errors are taken on the logs of
    --holdout.

    ```
    modelgap identify A.csv B.csv --robot arm.urdf --holdout C.csv
    modelgap identify A.csv B.csv --robot arm.urdf --consistent --export arm_new
    modelgap identify --robot irb140 --where "campaign = 'night'"
    ```

    Args:
        logs: Logs to fit: CSV or Parquet, a window as in FILE@0:16.5 or FILE@60%:,
            or the id of a run of the store.
        export: New folder for the identified URDF and robot.toml; give it as --robot.
    """
    request = chosen(request, logs, where, held_out_where)
    robot = load_for(request)
    choice = choose_for(request, robot)
    request = replace(request, model=choice.diagnosis)
    words = (*request.logs, *request.held_out, request.robot)
    out = Outputs({"--json": json}, read_files(words, request.columns))
    if export is not None:
        check_new_folder("--export", Path(export))
    read = identification.read_logs(request, robot)
    out.say(*read.lines[:1], *choice.lines, *read.lines[1:])
    made, kept = identification.identify(request, read)
    files = {}
    if export is not None:
        about = f"identified from {' '.join(made.fit)}"
        files = in_folder(export, robot_files(made.best, about))
    show(wide(out.console), *identified(made))
    out.write(document=lambda: identification_document(made), more=files)
    out.finish(*([f"stored as a model: modelgap show {kept}"] if kept else []))


def calibrate(
    *logs: Log,
    request: Calibrate,
    where: Where = None,
    report: File = None,
    json: Json = None,
    export: Folder = None,
) -> None:
    """Fit look-up tables to the residual of a model, and validate them in every way.

    Least squares, PLSR, the paper's nominal-level PLSR and a form that generalises are
    compared on runs left out, on families of motion left out, and on the paper's
    systematic and random rows. Where they disagree, the page says what random rows
    hide.

    ```
    modelgap calibrate A.csv B.csv C.csv --robot arm.urdf --report out.html
    modelgap calibrate 3f2a 77c0 90ab --robot irb140 --paper
    modelgap calibrate 3f2a 77c0 90ab --robot irb140 --export tables
    ```

    Args:
        logs: Logs: CSV or Parquet, a window as in FILE@0:16.5 or FILE@60%:, or the id
            of a run of the store. A single log is cut into parts.
        report: HTML page to write.
        json: File for all figures as JSON; "-" prints it and nothing else.
        export: New folder for the tables, the model that they correct, and programs
            that evaluate both.
    """
    from flows.report.calibration import render, told

    request = chosen(request, logs, where)
    inputs = read_files((*request.logs, request.robot), request.columns)
    out = Outputs({"--report": report, "--json": json}, inputs)
    if export is not None:
        check_new_folder("--export", Path(export))
    read, runs = calibration.read_logs(request)
    if request.paper:
        from flows.steps.experiment import with_twins

        runs = with_twins(read.robot, runs)
    out.say(*read.lines)
    with progress_bar() as progress:
        done = calibration.calibrate(request, read, runs, progress)
    made = done.calibration
    out.write(
        {"--report": lambda: render(made, done.warnings)},
        lambda: calibration_document(made, sentences(made), done.warnings, done.stored),
        in_folder(export, calibration_files(made)) if export is not None else {},
    )
    show(wide(out.console), *told(done))
    out.finish(*_kept(done))


def _kept(done: calibration.StoredCalibration) -> list[str]:
    if not done.stored:
        return []
    model, validation = done.stored["model"], done.stored["validation"]
    return [
        f"stored: model {model}, validation {validation}: modelgap show "
        f"{validation[:8]}"
    ]
