"""modelgap next: the motion that would settle what a verdict leaves open."""

import shlex
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from rich.console import Console

from flows.cli.options import (
    FASTEST,
    SEEDS,
    STDOUT,
    Flag,
    Log,
    Words,
    check_between,
    console_beside,
    named_files,
)
from flows.inputs.logs import is_run
from flows.outputs import (
    Progress,
    check_writable,
    json_text,
    progress_bar,
    read_files,
    say,
    write_all,
)
from flows.report.console import show
from flows.report.next import Sheet, comparison, nothing_open, render_sheet, told
from flows.report.words.verdict import sentences
from flows.settings import store_folder
from flows.steps.planning.ask import Asked, ask
from flows.steps.planning.design import Design, design
from flows.steps.planning.execute import execute, next_spec, settle
from flows.steps.planning.motions import Search, with_twins
from flows.steps.planning.request import Next
from flows.steps.planning.suggest import document
from flows.steps.trajectory import as_csv
from flows.storage.diagnosis import read_verdict
from residual.diagnosis.verdict import to_json
from residual.errors import InputError
from residual.planning.outlook import HOPELESS
from residual.threads import one_blas_thread
from sim.records import Reference, TrajectorySpec
from sim.trajectories import make_reference
from warehouse.objects.mirror import shown


def next_(
    verdict: str,
    /,
    *logs: Log,
    robot: str | None = None,
    baseline: Words = (),
    holdout: Words = (),
    want: str | None = None,
    seconds: float = 20.0,
    seed: int = 0,
    rate: float = 250.0,
    out: str | None = None,
    report: str | None = None,
    json: str | None = None,
    run: Flag = False,
    map: str | None = None,
    store: str | None = None,
) -> None:
    """Design the motion that tells apart what a verdict leaves open.

    The logs of the verdict are looked at once more; then motions of all families are
    searched for the one that brings most evidence between the rivals, within the
    limits of the arm. Of a diagnosis in the store all is known:

    ```
    modelgap next 3f2a --out program.csv --report program.html
    modelgap next 3f2a --run
    ```

    Of the JSON of a verdict, its logs and robot have to be named:

    ```
    modelgap next out.json A.csv B.csv --robot arm.urdf --out program.csv
    ```

    Or an effect is wished to be seen, if it is as large:

    ```
    modelgap next 3f2a --want "payload>=0.5" --seconds 12
    ```

    Args:
        verdict: Id of a diagnosis in the store (the beginning is enough), or the file
            of modelgap diagnose --json.
        logs: Logs of that file: CSV, Parquet, ROS bag or MCAP, or the id of a run.
        robot: Their robot: built-in name (irb140), URDF file, or folder.
        baseline: Their logs of healthy runs.
        holdout: Their logs for the proof.
        want: An effect and the least size that is to be seen, NAME>=SIZE or
            NAME@JOINT>=SIZE; its first parameter, in the unit of docs/effects.md.
        seconds: Length of the motion, 4 to 600.
        seed: Seed of the search.
        rate: Samples per second of the program.
        out: CSV for a controller: t (s), q1... (rad), qd1... (rad/s), qdd1...
            (rad/s^2).
        report: HTML page that says how to run it.
        json: File for the verdict with its next_experiment filled in; "-" prints it
            and nothing else.
        run: Run it on the simulated arm that the runs are of, and diagnose all logs
            together.
        map: TOML file that says which column is what, in which unit.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
    """
    request = Next(
        verdict=verdict,
        logs=logs,
        robot=robot,
        held_out=holdout,
        baseline=baseline,
        want=want,
        seconds=seconds,
        seed=seed,
        columns=map,
        store=store,
    )
    files = named_files({"--out": out, "--report": report, "--json": json})
    _check(request, files, rate, run)
    console = console_beside(json)
    with progress_bar() as progress:
        asked = ask(request, progress)
        if run:  # whether it can be is known before the search
            next_spec(store_folder(store), asked.request, TrajectorySpec())
        made = _designed(asked, request, progress)
    say(console, *asked.lines)
    if not asked.same:
        said = sentences(asked.found.verdict)[0]
        say(console, f"Warning: these logs say another thing than {verdict}: {said}")
    if made is None or made.best.seen.worth < HOPELESS:
        say(console, *nothing_open(asked, made))
        return
    reference = make_reference(asked.robot, made.best.spec, rate)
    filled = _filled(asked, made, out)
    _write(files, asked, made, reference, filled)
    wrote = [f"wrote {path}" for path in files.values()]
    show(console, *told(made), comparison(made), *wrote)
    if json == STDOUT:
        print(filled, end="")
    if run:
        _run(asked, made, console)


def _check(request: Next, files: Mapping[str, Path], rate: float, run: bool) -> None:
    stored = is_run(request.verdict)
    read = [] if stored else [Path(request.verdict)]
    words = (*request.logs, *request.baseline, *request.held_out)
    check_writable(files, read + read_files(words, request.columns, None))
    check_between("--rate", rate, 1, FASTEST)
    check_between("--seed", request.seed, 0, SEEDS)
    if run and not stored:
        raise InputError(
            "--run takes the id of a diagnosis in the store: only of its runs the "
            "arm is known. Without it, write the motion with --out."
        )


@one_blas_thread
def _designed(asked: Asked, request: Next, tell: Progress | None) -> Design | None:
    """Return the best motion; None where nothing is open."""
    if not asked.question.contests:
        return None
    wanted = Search(asked.question, asked.robot, request.seconds, request.seed)
    return design(with_twins(wanted), tell)


def _filled(asked: Asked, made: Design, out: str | None) -> str:
    """Return the verdict as JSON text, with what to do next."""
    plan = document(made, out and Path(out).name)
    return json_text(to_json(replace(asked.verdict, next_experiment=plan)))


def _write(
    files: Mapping[str, Path],
    asked: Asked,
    made: Design,
    reference: Reference,
    filled: str,
) -> None:
    make = {
        "--out": lambda: as_csv(reference),
        "--report": lambda: _page(asked, made, reference, files.get("--out")),
        "--json": lambda: filled,
    }
    write_all({path: make[option]() for option, path in files.items()})


def _page(
    asked: Asked, made: Design, reference: Reference, program: Path | None
) -> str:
    request = asked.request
    words = ["modelgap", "diagnose", *request.logs, "NEW_LOG", "--robot", request.robot]
    for option, more in (
        ("--holdout", request.held_out),
        ("--baseline", request.baseline),
    ):
        words += [option, *more] if more else []
    name = program and program.name
    return render_sheet(Sheet(asked, made, reference, name, shlex.join(words)))


def _run(asked: Asked, made: Design, console: Console) -> None:
    """Run the motion, diagnose all logs together, and say what came of it."""
    id = execute(asked.request, made.best.spec)
    say(console, f"ran it on the simulated arm: run {id}")
    with progress_bar() as progress:
        diagnosis, _ = settle(asked.request, id, progress)
    store = store_folder(asked.request.store)
    say(console, *sentences(read_verdict(store, diagnosis)))
    say(console, f"stored in {shown(store)}: modelgap show {diagnosis}")
