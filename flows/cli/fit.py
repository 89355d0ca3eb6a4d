"""modelgap identify and calibrate."""

from dataclasses import replace
from pathlib import Path

from flows.cli.app import Outputs
from flows.outputs import check_new_folder, list_input_files, place_in_folder, show_progress_bar
from flows.requests import Calibrate, File, HeldOutWhere, Identify, Json, Log, OutFolder, Where


def identify(
    *logs: Log,
    request: Identify,
    where: Where = None,
    held_out_where: HeldOutWhere = None,
    out: OutFolder = None,
    json: Json = None,
) -> None:
    """Identify the parameters of a robot model.

    Fits base inertial parameters and declared effects together, with standard
    deviations, and lists the parameters that the motion does not determine. Errors are
    those on the held-out logs.

    ```
    modelgap identify A.csv B.csv --robot arm.urdf --holdout C.csv
    modelgap identify A.csv B.csv --robot arm.urdf --consistent --out arm_new
    modelgap identify --robot irb140 --where "campaign = 'night'"
    ```

    Args:
        logs: Logs to fit: files, windows (FILE@0:16.5, FILE@60%:) or ids of stored
            runs.
        out: New folder for the identified URDF and robot.toml, for --robot.
    """
    from flows.inputs.read import load_request_robot, select_request_runs
    from flows.report.document import print_parts, widen_piped_console
    from flows.report.models import build_identification_parts as identified
    from flows.steps import identify as identification
    from flows.steps.model_choice import choose_request_model
    from flows.storage.identification_record import (
        build_identification_document as identification_document,
    )
    from residual.model.model_files import build_robot_folder

    request = select_request_runs(request, logs, where, held_out_where)
    robot = load_request_robot(request)
    choice = choose_request_model(request, robot)
    request = replace(request, model=choice.diagnosis)
    words = (*request.logs, *request.held_out, request.robot)
    outputs = Outputs({"--json": json}, list_input_files(words, request.columns))
    if out is not None:
        check_new_folder("--out", Path(out))
    read = identification.read_logs(request, robot)
    outputs.say(*read.lines[:1], *choice.lines, *read.lines[1:])
    outcome, kept = identification.identify(request, read)
    files = {}
    if out is not None:
        about = f"identified from {' '.join(outcome.fit)}"
        files = place_in_folder(out, build_robot_folder(outcome.best, about))
    print_parts(widen_piped_console(outputs.console), *identified(outcome))
    outputs.write(document=lambda: identification_document(outcome), more=files)
    outputs.finish(*([f"stored as a model: modelgap show {kept}"] if kept else []))


def calibrate(
    *logs: Log,
    request: Calibrate,
    where: Where = None,
    report: File = None,
    json: Json = None,
    out: OutFolder = None,
) -> None:
    """Fit look-up tables to the residual of a model, and validate them.

    Compares least squares, PLSR, the nominal-level PLSR of the paper and a table of
    main effects on runs left out, on motion families left out, and on the systematic
    and random rows of the paper.

    ```
    modelgap calibrate A.csv B.csv C.csv --robot arm.urdf --report out.html
    modelgap calibrate 3f2a 77c0 90ab --robot irb140 --paper
    modelgap calibrate 3f2a 77c0 90ab --robot irb140 --out tables
    ```

    Args:
        logs: Logs to fit: files, windows (FILE@0:16.5, FILE@60%:) or ids of stored
            runs. A single log is cut into parts.
        report: HTML file for the report.
        json: File for all figures as JSON; "-" prints it alone.
        out: New folder for the tables, their model, and evaluators in NumPy and C.
    """
    from flows.inputs.read import select_request_runs
    from flows.report.calibration import (
        build_terminal_parts,
        describe_calibration,
        render_calibration_page,
    )
    from flows.report.document import print_parts, widen_piped_console
    from flows.steps import calibrate as calibration
    from flows.storage.calibration import build_calibration_document as calibration_document
    from flows.storage.calibration import build_calibration_files

    request = select_request_runs(request, logs, where)
    inputs = list_input_files((*request.logs, request.robot), request.columns)
    outputs = Outputs({"--report": report, "--json": json}, inputs)
    if out is not None:
        check_new_folder("--out", Path(out))
    read, runs = calibration.read_logs(request)
    if request.paper:
        from flows.steps.experiment import add_twin_errors

        runs = add_twin_errors(read.robot, runs)
    outputs.say(*read.lines)
    with show_progress_bar() as progress:
        done = calibration.calibrate(request, read, runs, progress)
    result = done.calibration
    outputs.write(
        {"--report": lambda: render_calibration_page(result, done.warnings)},
        lambda: calibration_document(
            result, describe_calibration(result), done.warnings, done.stored
        ),
        place_in_folder(out, build_calibration_files(result)) if out is not None else {},
    )
    print_parts(widen_piped_console(outputs.console), *build_terminal_parts(done))
    if done.stored:
        model, validation = done.stored["model"], done.stored["validation"]
        outputs.say(f"stored: model {model}, validation {validation}")
    outputs.finish()
