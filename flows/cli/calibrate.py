"""modelgap calibrate: a data-driven correction, and what it is worth where."""

from pathlib import Path

from flows.cli.options import (
    STDOUT,
    Flag,
    Log,
    console_beside,
    named_files,
    parse_declared,
    parse_numbers,
)
from flows.outputs import (
    check_new_folder,
    check_writable,
    in_folder,
    json_text,
    progress_bar,
    read_files,
    say,
    write_all,
)
from flows.report.calibration import render, told
from flows.report.console import show, wide
from flows.report.words.calibration import sentences
from flows.requests import Calibrate
from flows.steps import calibrate as steps
from flows.steps.loop.choose import Wanted, choose_for
from flows.storage.calibration import calibration_files, document
from residual.calibration.rows import Run
from residual.robot.robot import Robot


def calibrate(
    *logs: Log,
    robot: str,
    paper: Flag = False,
    declared: str | None = None,
    map: str | None = None,
    report: str | None = None,
    json: str | None = None,
    export: str | None = None,
    store: str | None = None,
    trust_log: Flag = False,
    levels: str | None = None,
    components: int | None = None,
    joints: str | None = None,
    model: str | None = None,
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
        robot: Built-in name (irb140), URDF file, or folder with one *.urdf and an
            optional robot.toml.
        paper: As the paper does it: states of the reference of joints 1 to 3, errors
            against the simulated twin; only for logs with a reference (q_ref), on which
            the twin of a measured log is simulated.
        declared: Effects that the model has, as a,b; "none" for a bare rigid body.
            Without it the robot's own list, or viscous,coulomb,rotor_inertia.
        map: TOML file that says which column is what, in which unit.
        report: HTML page to write.
        json: File for all figures as JSON; "-" prints it and nothing else.
        export: New folder for the tables, the model that they correct, and programs
            that evaluate both.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
        trust_log: Go on although a fault of the logs is certain (modelgap check).
        levels: Levels of the paper form: 22 for every variable, or a number for each,
            as 8,8,8,22,22,22,2,2,2. Without it they are chosen on runs left out.
        components: Components of the paper form: at most so many are tried (30), and
            exactly so many exported if --levels are given.
        joints: Joints of states and torques, as 1,2,3. Without it all; with --paper
            the first three, as in the paper.
        model: Whose named effects stand beside the tables: the id of a diagnosis or an
            adoption, or nominal. Without it, on runs of the store, the model that the
            robot has (modelgap models), else the latest diagnosis of these runs.
    """
    names = parse_declared(declared)
    instead = "--paper" if paper else "--declared" if declared else None
    choice = choose_for(robot, Wanted(model, store, logs, instead))
    request = Calibrate(
        logs,
        robot,
        paper,
        names,
        columns=map,
        store=store,
        trust_log=trust_log,
        levels=parse_numbers("--levels", levels),
        components=components,
        joints=parse_numbers("--joints", joints),
        model=choice.diagnosis,
    )
    files = named_files({"--report": report, "--json": json})
    check_writable(files, read_files((*logs, robot), map))
    if export is not None:
        check_new_folder("--export", Path(export))
    console = console_beside(json)
    read, runs = steps.read_logs(request)
    if paper:
        runs = _with_twins(read.robot, runs)
    say(console, *read.lines[:1], *choice.lines, *read.lines[1:])
    with progress_bar() as progress:
        done = steps.calibrate(request, read, runs, progress)
    text = json_text(
        document(done.made, sentences(done.made), done.warnings, done.kept)
    )
    page = {"--report": render(done.made, done.warnings)} if report else {}
    contents = {path: (page | {"--json": text})[o] for o, path in files.items()}
    if export is not None:
        contents |= in_folder(export, calibration_files(done.made))
    write_all(contents)
    show(wide(console), *told(done))
    say(console, *(f"wrote {path}" for path in contents), *_kept(done))
    if json == STDOUT:
        print(text, end="")


def _kept(done: steps.Calibrated) -> list[str]:
    if not done.kept:
        return []
    model, validation = done.kept["model"], done.kept["validation"]
    return [
        f"stored: model {model}, validation {validation}: modelgap show "
        f"{validation[:8]}"
    ]


def _with_twins(robot: Robot, runs: tuple[Run, ...]) -> tuple[Run, ...]:
    # Here, since who calibrates in another way need not load the engine.
    from flows.steps.twin import with_twins

    return with_twins(robot, runs)
