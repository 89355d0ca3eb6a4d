"""modelgap calibrate: a data-driven correction, and what it is worth where."""

from typing import Annotated

from cyclopts import Parameter

from flows.cli.diagnose import parse_declared

_Flag = Annotated[bool, Parameter(negative="")]


def calibrate(
    *logs: Annotated[str, Parameter(name="LOG")],
    robot: str,
    paper: _Flag = False,
    declared: str | None = None,
    map: str | None = None,
    report: str | None = None,
    json: str | None = None,
    export: str | None = None,
    store: str | None = None,
) -> None:
    """Fit look-up tables to what a model leaves, and validate them in every way.

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
            against the simulated twin; only for runs that have both.
        declared: Effects that the model has, as a,b; "none" for a bare rigid body.
            Without it the robot's own list, or viscous,coulomb,rotor_inertia.
        map: TOML file that says which column is what, in which unit.
        report: HTML page to write.
        json: File for all figures as JSON; "-" prints it and nothing else.
        export: New folder for the tables and a program that evaluates them.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
    """
    from rich.console import Console

    from flows.progress import progress_bar
    from flows.steps import calibrate as steps

    request = steps.Request(
        logs=logs,
        robot=robot,
        paper=paper,
        declared=parse_declared(declared),
        columns=map,
        report=report,
        json=json,
        export=export,
        store=store,
    )
    # Where the JSON has standard output for itself, people read standard error.
    console = Console(stderr=json == "-")
    with progress_bar() as progress:
        outcome = steps.calibrate(request, console, progress)
    steps.tell(outcome, request, console)
