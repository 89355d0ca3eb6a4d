"""modelgap identify: the parameters of a robot's model, from logs or runs."""

from typing import Annotated

from cyclopts import Parameter

from flows.cli.diagnose import parse_declared

# Takes all following words up to the next option; at least one.
_Logs = Annotated[tuple[str, ...], Parameter(consume_multiple=(1, None), negative="")]
_Flag = Annotated[bool, Parameter(negative="")]


def identify(
    *logs: Annotated[str, Parameter(name="LOG")],
    robot: str,
    holdout: _Logs = (),
    method: str = "wls",
    declared: str | None = None,
    prior: float | None = None,
    essential: _Flag = False,
    consistent: _Flag = False,
    map: str | None = None,
    export: str | None = None,
    json: str | None = None,
    store: str | None = None,
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
    """
    from rich.console import Console

    from flows.steps import identify as steps

    request = steps.Request(
        logs=logs,
        robot=robot,
        held_out=holdout,
        declared=parse_declared(declared),
        method=method,
        prior=prior,
        essential=essential,
        consistent=consistent,
        columns=map,
        export=export,
        json=json,
        store=store,
    )
    # Where the JSON has standard output for itself, people read standard error.
    console = Console(stderr=json == "-")
    steps.tell(steps.identify(request, console), request, console)
