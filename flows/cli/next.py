"""modelgap next: the motion that would settle what a verdict leaves open."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from rich.console import Console

from flows.cli.app import FASTEST, SEEDS, Outputs, check_between
from flows.inputs.given import is_run
from flows.outputs import progress_bar, read_files, say
from flows.report.console import show
from flows.report.next import Sheet, comparison, nothing_open, render_sheet, told
from flows.report.page import command
from flows.report.words.verdict import sentences
from flows.requests import File, Flag, Hertz, Log, Next
from flows.settings import store_folder
from flows.steps.experiment import as_csv
from flows.steps.planning.ask import Asked, ask
from flows.steps.planning.design import Design, design, document
from flows.steps.planning.execute import execute, next_spec, settle
from flows.storage.diagnosis import read_verdict
from residual.diagnosis.verdict import to_json
from residual.errors import InputError
from residual.model.nominal import declared_names
from sim.engine.records import TrajectorySpec
from sim.trajectories import make_reference
from warehouse.remote import shown

_PLAIN = Next()


def next_(
    verdict: str,
    /,
    *logs: Log,
    request: Next = _PLAIN,
    rate: Hertz = 250.0,
    out: File = None,
    report: File = None,
    json: File = None,
    run: Flag = False,
) -> None:
    """Choose the motion that tells apart what a verdict leaves open.

    The logs of the verdict are looked at once more; then Fourier motions and moves,
    within the limits of the arm, are ranked by how soon each is sure which of the
    rivals is true. Of a diagnosis in the store all is known:

    ```
    modelgap next 3f2a --out program.csv --report program.html
    modelgap next 3f2a --run
    ```

    Of the JSON of a verdict, its logs and robot have to be named:

    ```
    modelgap next out.json A.csv B.csv --robot arm.urdf --out program.csv
    ```

    Args:
        verdict: Id of a diagnosis in the store (the beginning is enough), or the file
            of modelgap diagnose --json.
        logs: Logs of that file: CSV, Parquet, ROS bag or MCAP, or the id of a run.
        rate: Samples per second of the program.
        out: CSV for a controller: t (s), q1... (rad), qd1... (rad/s), qdd1...
            (rad/s^2).
        report: HTML page that says how to run it.
        json: File for the verdict with its next_experiment filled in; "-" prints it
            and nothing else.
        run: Run it on the simulated arm that the runs are of, and diagnose all logs
            together.
    """
    request = replace(request, verdict=verdict, logs=logs)
    outputs = _checked(
        request, {"--out": out, "--report": report, "--json": json}, rate, run
    )
    with progress_bar() as progress:
        opened = ask(request, progress)
        if run:  # whether it can be is known before the search
            next_spec(store_folder(request.store), opened.request, TrajectorySpec())
        made = design(
            opened.question, opened.robot, request.seconds, request.seed, progress
        )
    outputs.say(*opened.lines)
    if not opened.same:
        headline = sentences(opened.found.verdict)[0]
        outputs.say(f"Warning: these logs say another thing than {verdict}: {headline}")
    if made is None or made.best.seen.hopeless:
        outputs.say(*nothing_open(opened, made))
        return
    reference = make_reference(opened.robot, made.best.spec, rate)
    program = Path(out).name if out else None
    plan = document(made, program)
    outputs.write(
        {
            "--out": lambda: as_csv(reference),
            "--report": lambda: render_sheet(
                Sheet(opened, made, reference, program, _command(opened, request.store))
            ),
        },
        lambda: to_json(replace(opened.verdict, next_experiment=plan)),
    )
    show(outputs.console, *told(made), comparison(made))
    outputs.finish()
    if run:
        _run(opened, made, outputs.console)


def _checked(
    request: Next, options: Mapping[str, str | None], rate: float, run: bool
) -> Outputs:
    stored = is_run(request.verdict)
    words = (*request.logs, *request.baseline, *request.held_out)
    read = [] if stored else [Path(request.verdict)]
    outputs = Outputs(options, read + read_files(words, request.columns))
    check_between("--rate", rate, 1, FASTEST)
    check_between("--seed", request.seed, 0, SEEDS)
    if run and not stored:
        raise InputError(
            "--run takes the id of a diagnosis in the store: only of its runs the "
            "arm is known. Without it, write the motion with --out."
        )
    return outputs


def _command(opened: Asked, store: str | Path | None) -> str:
    """Return what diagnoses the new log with the others, asked as they were."""
    request, usual = opened.request, declared_names(opened.robot, None)
    declared = request.declared
    if declared is not None and set(declared) == set(usual):
        declared = None
    logs = (*request.logs, "NEW_LOG")
    return command(replace(request, logs=logs, declared=declared, store=store), None)


def _run(opened: Asked, made: Design, console: Console) -> None:
    """Run the motion, diagnose all logs together, and say what came of it."""
    id = execute(opened.request, made.best.spec)
    say(console, f"ran it on the simulated arm: run {id}")
    with progress_bar() as progress:
        diagnosis, _ = settle(opened.request, id, progress)
    store = store_folder(opened.request.store)
    say(console, *sentences(read_verdict(store, diagnosis)))
    say(console, f"stored in {shown(store)}: modelgap show {diagnosis}")
