"""modelgap demo and blind: arms that hide something, the truth shown last."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from rich.console import Console

from flows.blind.draw import StudyRequest
from flows.blind.export.write import check_target, export_study
from flows.blind.run import run_study
from flows.cli.app import LONGEST, SEEDS, Outputs, check_between, check_workers
from flows.outputs import progress_bar, say
from flows.report.console import show
from flows.report.diagnosis import print_diagnosis, print_truth
from flows.report.stored import as_hidden, demo_page
from flows.report.study import store_page, told
from flows.report.words.phrases import Staged
from flows.requests import Flag, Store
from flows.settings import cores, store_folder
from flows.steps import demo as steps
from flows.steps.diagnose import diagnose_runs, request_of
from flows.storage.diagnosis import read_outcome
from flows.workers.pool import Pool
from residual.errors import InputError, RunError
from warehouse.mirror import shown

MOST_ARMS = 20
# As it was once called; a demonstration is always plain now.
Plain = Annotated[Flag, Parameter(show=False)]
_USUAL, _STUDY = steps.Demo(), StudyRequest()


def demo(*, request: steps.Demo = _USUAL, plain: Plain = False) -> None:
    """Find the effect that a simulated arm hides from its model.

    Runs six experiments of three families on the arm in a physics engine, and two that
    no fit will see; stores them, finds from the stored logs what the model lacks, adds
    it, shows the error before and after, and writes a report. Then the seal is opened
    and the truth shown beside the verdict. Runs are kept: a second time is quicker.

    ```
    modelgap demo
    modelgap demo --effect spring --seed 3
    ```
    """
    del plain
    place, console = store_folder(request.store), Console()
    check_between("--seed", request.seed, 0, SEEDS)
    request = replace(request, store=place)
    # Before anything is started, so that a wrong word is answered at once.
    count = len(steps.specs(request))
    arm = f"the simulated {steps.ROBOT}, background {request.background}"
    say(console, f"{count} experiments on {arm}, into {shown(place)}")
    with progress_bar() as progress:
        runs = steps.run_experiments(request, progress)
        ids = diagnose_runs(request_of(runs, place), progress)
        hidden = steps.open_seal(runs, ids[0], place)
        page = demo_page(ids, runs["fit"][0], hidden, place)
    outcome = read_outcome(place, ids[1])
    print_diagnosis(outcome, console)
    print_truth(Staged(b"", "", as_hidden(hidden), outcome.verdict), console)
    say(console, f"\nreport: {page}")


def blind(
    *,
    request: StudyRequest = _STUDY,
    store: Store = None,
    report: str | None = None,
    workers: int | None = None,
    export: str | None = None,
    arms: int = 1,
) -> None:
    """Hide effects from the diagnosis and count how often it is right.

    Draws what an arm hides: one effect, two, none, or one that has no name; joint, size
    in minimum detectable ones, motions, noise. Runs it in the physics engine with the
    truth sealed, diagnoses the stored runs, and opens the seal when the verdict is
    committed. Interrupted, the same command goes on; with a larger --n it goes further.

    ```
    modelgap blind --n 20 --seed 1 --report blind.html
    modelgap sql --named blind_confusion
    ```

    For any other program: the same cases as plain files, nothing diagnosed.

    ```
    modelgap blind --n 20 --seed 1 --arms 2 --background clean --export cases
    python cases/sealed/score.py answers.json
    ```

    Args:
        report: HTML page to write; it is in the store in any case.
        workers: Number of processes; one per core without it.
        export: New folder for the cases as CSV, URDF and JSON, the truth apart, with a
            program that scores answers (README.md in it); nothing is diagnosed but arms
            with nothing to hide, for their detectable sizes.
        arms: Number of arms of an export: the built-in one, the others drawn.
    """
    place, console = store_folder(store), Console()
    check_between("--duration", request.duration, 0.1, LONGEST)
    check_workers(workers)
    if export is not None:
        if report is not None:
            raise InputError("--export diagnoses nothing, so it has no --report.")
        _export(request, Path(export), arms, place, workers)
        return
    if arms != 1:
        raise InputError("--arms is for --export; a study has the built-in arm.")
    out = Outputs({"--report": report})
    with progress_bar() as progress:
        study = run_study(request, place, progress, workers=workers)
    page = store_page(request, study, place)
    show(console, *told(study))
    out.write({"--report": page.read_bytes})
    say(console, f"\nreport: {report or page}")
    if study.failed:
        raise RunError(
            f"{len(study.failed)} of {request.n} cases failed: {study.failed[0]}"
        )


def _export(
    request: StudyRequest, target: Path, arms: int, store: Path, workers: int | None
) -> None:
    if not 1 <= arms <= MOST_ARMS:
        raise InputError(f"--arms is {arms}, expected 1 to {MOST_ARMS}.")
    check_target(target)
    with progress_bar() as progress, Pool(workers or cores()) as pool:
        export_study(request, range(arms), target, store, pool, progress)
    say(
        Console(),
        f"wrote {target}: {request.n} cases; its README.md says what is where",
    )
