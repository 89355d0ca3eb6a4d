"""modelgap identify: the parameters of a robot's model, from logs or runs."""

from pathlib import Path

from flows.cli.options import (
    STDOUT,
    Flag,
    Log,
    Words,
    console_beside,
    named_files,
    parse_declared,
)
from flows.outputs import (
    check_new_folder,
    check_writable,
    in_folder,
    json_text,
    read_files,
    say,
    write_all,
)
from flows.report.console import show, wide
from flows.report.models import identification
from flows.requests import Identify
from flows.steps import identify as steps
from flows.steps.loop.choose import Wanted, choose_for
from flows.storage.identification import document
from residual.model.export import robot_files


def identify(
    *logs: Log,
    robot: str,
    holdout: Words = (),
    method: str = "wls",
    declared: str | None = None,
    prior: float | None = None,
    essential: Flag = False,
    consistent: Flag = False,
    map: str | None = None,
    export: str | None = None,
    json: str | None = None,
    store: str | None = None,
    trust_log: Flag = False,
    model: str | None = None,
) -> None:
    """Identify the parameters of a robot's model.

    Base inertial parameters and declared effects are fitted together, with standard
    deviations; what the motion cannot tell is said. Errors are taken on the logs of
    --holdout.

    ```
    modelgap identify A.csv B.csv --robot arm.urdf --holdout C.csv
    modelgap identify A.csv B.csv --robot arm.urdf --consistent --export arm_new
    ```

    Args:
        logs: Logs to fit: CSV or Parquet, a window as in FILE@0:16.5 or FILE@60%:,
            or the id of a run of the store.
        robot: Built-in name (irb140), URDF file, or folder with one *.urdf and an
            optional robot.toml.
        holdout: Logs for the proof. Without them the last quarter of the longest log.
        method: ols (all rows alike), wls (each joint by its noise), irls (outliers
            count less).
        declared: Effects that the model has, as a,b; "none" for a bare rigid body.
            Without it the robot's own list, or viscous,coulomb,rotor_inertia.
        prior: How far nominal values may be off, such as 0.03; without it the fit is
            free.
        essential: Drop parameters that the logs do not need.
        consistent: Also find parameters that bodies can have: positive masses and
            pseudo-inertias, nearest to the nominal. Needs the extra [sdp].
        map: TOML file that says which column is what, in which unit.
        export: New folder for the identified URDF and robot.toml; give it as --robot.
        json: File for the outcome as JSON; "-" prints it and nothing else.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
        trust_log: Go on although a fault of the logs is certain (modelgap check).
        model: Model to start from: the id of a diagnosis or an adoption, or nominal.
            Without it, on runs of the store, the one that the robot has (modelgap
            models), its named effects among what is fitted.
    """
    words = Wanted(model, store, (*logs, *holdout), "--declared" if declared else None)
    choice = choose_for(robot, words)
    request = Identify(
        logs=logs,
        robot=robot,
        held_out=holdout,
        declared=parse_declared(declared),
        method=method,
        prior=prior,
        essential=essential,
        consistent=consistent,
        columns=map,
        store=store,
        trust_log=trust_log,
        model=choice.diagnosis,
    )
    files = named_files({"--json": json})
    check_writable(files, read_files((*logs, *holdout, robot), map))
    if export is not None:
        check_new_folder("--export", Path(export))
    console = console_beside(json)
    read = steps.read_logs(request)
    say(console, *read.lines[:1], *choice.lines, *read.lines[1:])
    made, kept = steps.identify(request, read)
    text = json_text(document(made))
    contents = {path: text for path in files.values()}
    if export is not None:
        words = f"identified from {' '.join(made.fit)}"
        contents |= in_folder(export, robot_files(made.best, words))
    show(wide(console), *identification(made))
    write_all(contents)
    say(console, *(f"wrote {path}" for path in contents))
    if kept is not None:
        say(console, f"stored as a model: modelgap show {kept}")
    if json == STDOUT:
        print(text, end="")
