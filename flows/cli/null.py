"""modelgap calibrate-null: how much evidence chance alone makes, and how often."""

from typing import Annotated

from cyclopts import Parameter

from flows.say import say

_Logs = Annotated[tuple[str, ...], Parameter(consume_multiple=(1, None), negative="")]


def calibrate_null(
    *logs: Annotated[str, Parameter(name="LOG")],
    robot: str,
    baseline: _Logs = (),
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
        baseline: Logs of the robot in good order, if they will be diagnosed with them.
        declared: Effects that the model has, as a,b; "none" for a bare rigid body.
        map: TOML file that says which column is what, in which unit.
        draws: Number of recordings; one in 200 is the least p-value of 200.
        seed: Seed of their noise.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
        out: JSON file to write as well.
        workers: Number of processes; one per core without it.
    """
    from pathlib import Path

    from rich.console import Console

    from flows.cli.diagnose import parse_declared
    from flows.outputs import check_writable, read_files, write_all
    from flows.progress import progress_bar
    from flows.settings import store_folder
    from flows.steps import null as steps
    from residual.errors import InputError

    if workers is not None and workers < 1:
        raise InputError(f"--workers is {workers}, expected 1 or more.")
    read = read_files((*logs, *baseline))
    check_writable({"--out": Path(out)} if out else {}, read)
    names = parse_declared(declared)
    asked = steps.Asked(logs, robot, tuple(baseline), names, map, draws, seed, store)
    with progress_bar() as bar:
        made = steps.calibrate(asked, bar, workers=workers)
    files = {Path(out): steps.null_json(made.null)} if out else {}
    write_all(files)
    console = Console()
    wrote = (f"wrote {f}" for f in files)
    say(console, *_lines(made, draws, store_folder(store)), *wrote)
    if not made.complete:
        raise KeyboardInterrupt


def _lines(made, draws: int, store) -> list[str]:
    """Return what a null says, a sentence each."""
    from residual.diagnosis.search import Rules

    null = made.null
    least = Rules().threshold
    threshold, beyond = null.threshold(least), null.beyond(null.threshold(least))
    chance = f"{100 * beyond:.2g} %" if beyond > 1e-4 else "less than 0.01 %"
    lines = [
        null.sentence(least),
        f"an exponential tail, fitted to the largest fifth, has {chance} of such "
        f"recordings reach {threshold:.1f} nats: an extrapolation",
        f"draws: {len(null.net)} in {len(set(null.block))} recordings of encoder noise "
        f"(as good as {null.independent:.0f} independent ones), {made.known} known "
        "before",
        f"stored in {store}: modelgap show {null.id}",
    ]
    if not made.complete:
        lines.append(
            f"interrupted: {len(null.net)} of {draws} draws are kept; the same command "
            "goes on"
        )
    return lines
