"""The commands that take logs: check, map, import, diagnose, next, identify, calibrate."""

from dataclasses import replace
from pathlib import Path
from time import perf_counter

from rich.console import Console

from flows.cli import FASTEST, SEEDS, Outputs, check_option_range
from flows.outputs import list_input_files, print_plain, show_progress_bar
from flows.requests import (
    Calibrate,
    Check,
    Diagnose,
    File,
    Flag,
    HeldOutWhere,
    Hertz,
    Identify,
    Import,
    Json,
    Log,
    Name,
    Next,
    OutFolder,
    Program,
    Report,
    RobotRequest,
    Where,
)
from flows.settings import resolve_store_folder
from residual.errors import InputError


def check(*logs: Log, request: Check, json: Json = None) -> None:
    """Check the units, signs, joint order, timing and sensors of logs.

    Without a log it checks the robot file: its joints, limits and bodies, and their
    plausibility.

    Prints each fault with its evidence, whether it is certain, and the line of the map
    or the robot file that fixes it. A certain fault stops diagnose, identify, calibrate
    and import; here the exit code is 0 in any case.

    ```
    modelgap check A.csv B.csv --robot arm.urdf
    modelgap check A.csv --robot arm.urdf --map COLUMNS.toml --json check.json
    modelgap check --robot arm.urdf
    ```

    Args:
        logs: Logs: CSV, Parquet, ROS bag or MCAP files, windows (FILE@0:16.5,
            FILE@60%:) or ids of stored runs; none to check the robot file alone.
    """
    from flows.inputs import read_logs
    from flows.report import print_parts
    from flows.report.models import build_robot_document, describe_robot_check
    from flows.report.sentences import describe_faults, summarize_check
    from flows.steps import check as checking

    request = replace(request, logs=logs)
    out = Outputs({"--json": json}, list_input_files((*logs, request.robot), request.columns))
    if not logs:
        robot, report = checking.check_robot_file(request)
        out.write(document=lambda: build_robot_document(robot, report))
        print_parts(out.console, *describe_robot_check(robot, report))
        return out.finish()
    read = read_logs(request, "to check")
    out.say(*read.lines[1:])
    report = checking.check_log_sets(read)
    out.write(document=report.to_json)
    out.say("", summarize_check(report), *describe_faults(report))
    return out.finish()


def map_(log: Log, /, *, request: RobotRequest, format: Name = None, out: File = None) -> None:
    """Draft the column map of a log.

    Uses the column names, the stated units, the joint names of the URDF and the
    numbers. Check the draft, then give it as --map, or copy its lines to [columns] of
    robot.toml. Comments with "?" mark guesses.

    ```
    modelgap map log.csv --robot arm.urdf --out COLUMNS.toml
    modelgap diagnose log.csv --robot arm.urdf --map COLUMNS.toml
    ```

    Knows the names of Universal Robots (RTDE), Franka (libfranka), KUKA (FRI) and ROS
    joint states.

    Args:
        log: CSV, Parquet, ROS bag or MCAP file.
        format: Format of the log, where it is not recognized: ur-rtde, franka,
            kuka-fri, robotstudio, mujoco, plotjuggler, lerobot or ros.
        out: File for the map; default: print it.
    """
    from flows.steps import check as checking

    files = list_input_files((log, request.robot))
    outputs = Outputs({"--out": out}, files)
    text = checking.draft_map(log, request.robot, format)
    if out is None:
        print(text, end="")
        return
    if Path(out).exists() and Path(out).read_bytes() != text.encode():
        raise InputError(f"--out {out} exists with other content. Name another file, or delete it.")
    unsure = [line[4:] for line in text.splitlines() if line.startswith("# ?")]
    outputs.say(*(f"not certain: {line}" for line in unsure))
    outputs.write({"--out": lambda: text})
    outputs.finish()


def import_(*logs: Log, request: Import, dry_run: Flag = False) -> None:
    """Import measured logs as runs of the store.

    Other commands and SQL then take the ids of the runs.

    ```
    modelgap import monday.csv --robot arm.urdf --dry-run
    modelgap import monday.csv tuesday.mcap --robot arm.urdf --map COLUMNS.toml
    modelgap import weld.bag@2:40 --robot arm_folder --trajectory welding
    ```

    Reads CSV with any separator, also with the header lines of RobotStudio, Parquet,
    ROS 1 and ROS 2 bags, and MCAP. Of bags it reads the joint states, by the joint
    names of the URDF. A log that is already stored is not stored again.

    Args:
        logs: Log files; FILE@0:16.5 is a window in seconds from the first sample.
        dry_run: Show the columns and the id, store nothing.
    """
    from flows.report import print_parts
    from flows.report.models import build_channel_table, describe_imported_log
    from flows.steps import imports
    from warehouse.remote_store import format_store_name

    place, console = resolve_store_folder(request.store), Console()
    request = replace(request, logs=logs, store=place)
    arm, read = imports.read_logs(request)
    print_plain(console, *(f"{arm.name}: {note}" for note in arm.notes))
    for log in read:
        if dry_run:
            print_parts(console, build_channel_table(log))
        print_plain(console, *describe_imported_log(log, arm, dry_run))
    sound, report = imports.check_logs(request, arm, read)
    print_plain(console, *(f"warning: {sentence}" for sentence in report.sentences))
    for log in () if dry_run else sound:
        id = imports.store_log(log, request, arm)
        word = "already in" if log.stored else "stored in"
        print_plain(console, f"{id}  {log.summary.id}: {word} {format_store_name(place)}")
        if log.stored and (request.tags or request.recorded_at):
            print_plain(console, "  its stored tags and time are unchanged")


def diagnose(
    *logs: Log,
    request: Diagnose,
    where: Where = None,
    held_out_where: HeldOutWhere = None,
    report: Report = None,
    json: File = None,
    save_model: File = None,
) -> None:
    """Find and name the effects missing from a robot model.

    Fits the model to the logs, adds the effects that the logs show and the model
    lacks, and compares the errors on the held-out logs of --holdout.

    ```
    modelgap diagnose A.csv B.csv --robot arm.urdf --holdout C.csv --report out.html
    ```

    With one log only, fit its first part and hold out the rest:

    ```
    modelgap diagnose run.csv@:60% --robot arm.urdf --holdout run.csv@60%:
    ```

    With logs of the healthy robot, only changes are named:

    ```
    modelgap diagnose today.csv --robot arm.urdf --baseline healthy.csv
    ```

    Columns t (s), q1... (rad) and tau1... (N m) need no --map; no unit is guessed. The
    diagnosis of stored runs is stored too, and its model can be adopted (modelgap
    adopt).

    Args:
        logs: Logs to fit: CSV, Parquet, ROS bag or MCAP file, or id of a stored run.
            FILE@0:16.5 is a window in seconds from the first sample, FILE@60%: the last
            40 percent.
        json: File for the verdict as JSON; "-" prints it alone.
        save_model: File for the augmented model, for predict and export.
    """
    from flows.inputs import load_request_robot, select_request_runs
    from flows.report.charts import render_diagnosis_page
    from flows.report.diagnosis import print_diagnosis
    from flows.report.page import describe_request_origin
    from flows.steps import diagnose as steps
    from flows.steps.model_choice import choose_request_model
    from residual.model.model_files import format_model
    from residual.verdict.document import to_json

    request = select_request_runs(request, logs, where, held_out_where)
    robot = load_request_robot(request)
    choice = choose_request_model(request, robot)
    request = replace(request, model=choice.diagnosis)
    words = (*request.logs, *request.baseline, *request.held_out, request.robot)
    inputs = list_input_files(words, request.columns)
    files = {"--report": report, "--json": json, "--save-model": save_model}
    out = Outputs(files, inputs)
    read = steps.read_logs(request, robot)
    out.say(*read.lines[:1], *choice.lines, *read.lines[1:])
    stored = steps.resolve_whole_runs(read)
    begun = perf_counter()
    with show_progress_bar() as progress:
        result = steps.diagnose(request, stored or read, progress)
    took = perf_counter() - begun
    # The warnings about the logs were printed before the work.
    out.say(*result.notes[len(read.lines) :])

    def page() -> str:
        origin = describe_request_origin(request, str(report))
        return render_diagnosis_page(result, result.verdict.robot, origin=origin)

    out.write(
        {"--report": page, "--save-model": lambda: format_model(result.models["augmented"])},
        lambda: to_json(result.verdict),
    )
    print_diagnosis(result, out.console)
    kept = steps.store_diagnosis(request, stored, result, took)[0] if stored else None
    out.finish(*([f"stored as a diagnosis: modelgap show {kept}"] if kept else []))


def next_(
    verdict: str,
    /,
    *logs: Log,
    request: Next = Next(),
    rate: Hertz = 250.0,
    out: Program = None,
    json: File = None,
) -> None:
    """Choose the motion that separates the open rivals of a verdict.

    Diagnoses the logs of the verdict again, then ranks Fourier motions and moves within
    the limits of the arm by the time after which they decide between the rivals. For a
    stored diagnosis:

    ```
    modelgap next 3f2a --out program.csv
    ```

    For the JSON file of a verdict, with its logs and its robot:

    ```
    modelgap next out.json A.csv B.csv --robot arm.urdf --out program.csv
    ```

    Args:
        verdict: Id of a stored diagnosis, or its beginning, or a file of modelgap
            diagnose --json.
        logs: Logs of that file: CSV, Parquet, ROS bag or MCAP, or ids of runs.
        rate: Samples per second of the program.
        json: File for the verdict with its next_experiment; "-" prints it alone.
    """
    from flows.inputs import is_run_id
    from flows.report import print_parts
    from flows.report.experiments import (
        build_ranking_table,
        describe_best_motion,
        explain_no_experiment,
    )
    from flows.report.sentences import list_headline_sentences
    from flows.steps.experiment import format_reference_csv
    from flows.steps.next import rank_motions, reopen_diagnosis
    from residual.verdict.document import to_json
    from sim.trajectories import plan_reference_motion

    request = replace(request, verdict=verdict, logs=logs)
    words = (*request.logs, *request.baseline, *request.held_out)
    read = [] if is_run_id(verdict) else [Path(verdict)]
    options = {"--out": out, "--json": json}
    outputs = Outputs(options, read + list_input_files(words, request.columns))
    check_option_range("--rate", rate, 1, FASTEST)
    check_option_range("--seed", request.seed, 0, SEEDS)
    with show_progress_bar() as progress:
        opened = reopen_diagnosis(request, progress)
        ranking = rank_motions(
            opened.question, opened.robot, request.seconds, request.seed, progress
        )
    outputs.say(*opened.lines)
    if not opened.reproduced:
        headline = list_headline_sentences(opened.diagnosis.verdict)[0]
        outputs.say(f"Warning: these logs give another verdict than {verdict}: {headline}")
    if ranking is None or ranking.best.outlook.separates_nothing:
        outputs.say(*explain_no_experiment(opened, ranking))
        return
    plan = ranking.document(Path(out).name if out else None)
    outputs.write(
        {
            "--out": lambda: format_reference_csv(
                plan_reference_motion(opened.robot, ranking.best.spec, rate)
            )
        },
        lambda: to_json(replace(opened.verdict, next_experiment=plan)),
    )
    print_parts(outputs.console, *describe_best_motion(ranking), build_ranking_table(ranking))
    outputs.finish()


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
    from flows.inputs import load_request_robot, select_request_runs
    from flows.report import print_parts, widen_piped_console
    from flows.report.models import build_identification_parts as identified
    from flows.steps import fit
    from flows.steps.model_choice import choose_request_model
    from residual.model.model_files import build_robot_folder

    request = select_request_runs(request, logs, where, held_out_where)
    robot = load_request_robot(request)
    choice = choose_request_model(request, robot)
    request = replace(request, model=choice.diagnosis)
    words = (*request.logs, *request.held_out, request.robot)
    outputs = Outputs({"--json": json}, list_input_files(words, request.columns), out)
    read = fit.read_identification_logs(request, robot)
    outputs.say(*read.lines[:1], *choice.lines, *read.lines[1:])
    outcome, kept = fit.identify(request, read)
    print_parts(widen_piped_console(outputs.console), *identified(outcome))
    outputs.write(
        document=lambda: fit.build_identification_document(outcome),
        folder=lambda: build_robot_folder(outcome.best, f"identified from {' '.join(outcome.fit)}"),
    )
    outputs.finish(*([f"stored as a model: modelgap show {kept}"] if kept else []))


def calibrate(
    *logs: Log,
    request: Calibrate,
    where: Where = None,
    report: Report = None,
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
        json: File for all figures as JSON; "-" prints it alone.
        out: New folder for the tables, their model, and evaluators in NumPy and C.
    """
    from flows.inputs import select_request_runs
    from flows.report import print_parts, widen_piped_console
    from flows.report.calibration import (
        build_terminal_parts,
        describe_calibration,
        render_calibration_page,
    )
    from flows.steps import fit

    request = select_request_runs(request, logs, where)
    inputs = list_input_files((*request.logs, request.robot), request.columns)
    outputs = Outputs({"--report": report, "--json": json}, inputs, out)
    read, runs = fit.read_calibration_runs(request)
    if request.paper:
        from flows.steps.experiment import add_twin_errors

        runs = add_twin_errors(read.robot, runs)
    outputs.say(*read.lines)
    with show_progress_bar() as progress:
        done = fit.calibrate(request, read, runs, progress)
    result = done.calibration
    outputs.write(
        {"--report": lambda: render_calibration_page(result, done.warnings)},
        lambda: fit.build_calibration_document(
            result, describe_calibration(result), done.warnings, done.stored
        ),
        lambda: fit.build_calibration_files(result),
    )
    print_parts(widen_piped_console(outputs.console), *build_terminal_parts(done))
    if done.stored:
        model, validation = done.stored["model"], done.stored["validation"]
        outputs.say(f"stored: model {model}, validation {validation}")
    outputs.finish()
