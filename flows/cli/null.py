"""modelgap calibrate-null: how much evidence chance alone makes, and how often."""

from rich.console import Console

from flows.cli.options import (
    SEEDS,
    Log,
    Words,
    check_between,
    named_files,
    parse_declared,
)
from flows.outputs import check_writable, progress_bar, read_files, say, write_all
from flows.report.monitoring import null_lines
from flows.requests import Null
from flows.settings import store_folder
from flows.steps import null as steps
from flows.storage.null import null_json
from residual.errors import InputError


def calibrate_null(
    *logs: Log,
    robot: str,
    baseline: Words = (),
    declared: str | None = None,
    map: str | None = None,
    draws: int = 200,
    seed: int = 0,
    store: str | None = None,
    out: str | None = None,
    workers: int | None = None,
) -> None:
    """State the false-alarm rate of a diagnosis: once per robot, motion and noise.

    Makes recordings in which nothing is missing, with the motion, the model and the
    noise of the logs, encoder and torque noise drawn anew, and searches them as a
    diagnosis does. The store keeps what they show; a later diagnosis of such logs with
    that robot finds it there, and states a p-value.

    ```
    modelgap calibrate-null A.csv B.csv --robot arm.urdf
    modelgap calibrate-null A.csv B.csv --robot arm.urdf --out null.json
    modelgap diagnose A.csv B.csv --robot arm.urdf --null null.json
    ```

    Interrupted, it keeps what is finished; the same command goes on.

    Args:
        logs: Logs as they will be diagnosed: CSV, Parquet, or ids of runs.
        robot: Built-in name, URDF file, or folder with one *.urdf and an optional
            robot.toml.
        baseline: Refused: what is compared with healthy runs needs no null.
        declared: Effects that the model has, as a,b; "none" for a bare rigid body.
        map: TOML file that says which column is what, in which unit.
        draws: Number of recordings; one in 200 is the least p-value of 200.
        seed: Seed of their noise.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
        out: JSON file to write as well.
        workers: Number of processes; one per core without it.
    """
    if baseline:
        raise InputError(
            "--baseline: a comparison with healthy runs needs no null: those runs show "
            "what chance does. Leave it out, or diagnose at once: "
            "modelgap diagnose LOG ... --baseline HEALTHY ... --robot R."
        )
    check_between("--seed", seed, 0, SEEDS)
    check_between("--draws", draws, 1, 1_000_000)
    if workers is not None and workers < 1:
        raise InputError(f"--workers is {workers}, expected 1 or more.")
    files = named_files({"--out": out})
    check_writable(files, read_files(logs))
    names = parse_declared(declared)
    request = Null(logs, robot, names, map, draws, seed, store)
    with progress_bar() as progress:
        made = steps.calibrate_null(request, progress, workers=workers)
    write_all({path: null_json(made.null) for path in files.values()})
    wrote = (f"wrote {path}" for path in files.values())
    say(Console(), *null_lines(made, draws, store_folder(store)), *wrote)
    if not made.complete:
        raise KeyboardInterrupt
