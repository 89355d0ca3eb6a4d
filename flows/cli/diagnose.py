"""modelgap diagnose: what the model lacks, from measured logs."""

from typing import Annotated

from cyclopts import Parameter

# Takes all following words up to the next option; at least one.
_Logs = Annotated[tuple[str, ...], Parameter(consume_multiple=(1, None), negative="")]


def diagnose(
    *logs: Annotated[str, Parameter(name="LOG")],
    robot: str,
    baseline: _Logs = (),
    holdout: _Logs = (),
    declared: str | None = None,
    map: str | None = None,
    report: str | None = None,
    json: str | None = None,
    null: str | None = None,
    store: str | None = None,
) -> None:
    """Name what the model of a robot lacks, from its logs.

    The logs to diagnose come first. The model is fitted to them, effects that they
    show and the model lacks are added, and the error before and after is taken on
    the logs of --holdout.

    ```
    modelgap diagnose A.csv B.csv --robot arm.urdf --holdout C.csv --report out.html
    ```

    One log only: fit its first part, prove on the rest.

    ```
    modelgap diagnose run.csv@:60% --robot arm.urdf --holdout run.csv@60%:
    ```

    What has changed since the robot was in good order?

    ```
    modelgap diagnose today.csv --robot arm.urdf --baseline healthy.csv
    ```

    Logs with columns t (s), q1... (rad), tau1... (N m) are read as they are; anything
    else needs a --map. Nothing is converted by guess.

    Args:
        logs: Logs to diagnose: CSV, Parquet, ROS bag or MCAP, or the id of a run of
            the store. FILE@0:16.5 takes a window in seconds from the first sample,
            FILE@60%: the last 40 percent.
        robot: Built-in name (irb140), URDF file, or folder with one *.urdf and an
            optional robot.toml.
        baseline: Logs of the robot in good order; then what has changed is named.
        holdout: Logs for the proof. Without them the last quarter of the longest log.
        declared: Effects that the model has, as a,b; "none" for a bare rigid body.
            Without it the robot's own list, or viscous,coulomb,rotor_inertia.
        map: TOML file that says which column is what, in which unit.
        report: HTML page to write.
        json: File for the verdict as JSON; "-" prints it and nothing else.
        null: What modelgap calibrate-null wrote with --out; without it, one that fits
            is looked for in the store.
        store: Folder of the store with runs and nulls; else $MODELGAP_STORE, else
            ./store.
    """
    from rich.console import Console

    from flows.progress import progress_bar
    from flows.steps import diagnose as steps

    request = steps.Request(
        logs=logs,
        robot=robot,
        baseline=baseline,
        held_out=holdout,
        declared=parse_declared(declared),
        columns=map,
        report=report,
        json=json,
        null=null,
        store=store,
    )
    # Where the JSON has standard output for itself, people read standard error.
    console = Console(stderr=json == "-")
    with progress_bar() as progress:
        outcome = steps.diagnose(request, console, progress)
    steps.tell(outcome, request, console)


def parse_declared(text: str | None) -> tuple[str, ...] | None:
    """Return the names in "a,b", () for "none", None for no text."""
    if text is None:
        return None
    if text.strip() == "none":
        return ()
    return tuple(dict.fromkeys(name.strip() for name in text.split(",")))
