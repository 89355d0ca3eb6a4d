"""modelgap blind: the sealed study, which says how often the diagnosis is right."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from rich.console import Console

from flows.blind.draw import Asked
from flows.blind.export.write import check_target, export_study
from flows.blind.run import run_study
from flows.cli.options import LONGEST, SEEDS, check_between, named_files
from flows.errors import RunError
from flows.outputs import check_writable, progress_bar, say, write_all
from flows.report.console import show
from flows.report.study import store_page, told
from flows.settings import cores, store_folder
from flows.workers.pool import Pool
from residual.errors import InputError
from sim.records import WORKSHOP, BackgroundWord

MOST_ARMS = 20


def blind(
    *,
    n: Annotated[int, Parameter(name="--n")] = 20,
    seed: int = 0,
    store: str | None = None,
    report: str | None = None,
    workers: int | None = None,
    duration: float = 20.0,
    background: BackgroundWord = WORKSHOP,
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
        n: Number of cases; 20 to 30 s of one core each.
        seed: Seed of everything; the same seed is the same study.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
        report: HTML page to write; it is in the store in any case.
        workers: Number of processes; one per core without it.
        duration: Length of every experiment [s].
        background: What all joints have beside what is hidden: nothing, that of an arm
            in use, or twice as much.
        export: New folder for the cases as CSV, URDF and JSON, the truth apart, with a
            program that scores answers (README.md in it); nothing is diagnosed but arms
            with nothing to hide, for their detectable sizes.
        arms: Number of arms of an export: the built-in one, the others drawn.
    """
    place, console = store_folder(store), Console()
    check_between("--seed", seed, 0, SEEDS)
    check_between("--duration", duration, 0.1, LONGEST)
    asked = Asked(n, seed, duration=duration, background=background)
    if workers is not None and workers < 1:
        raise InputError(f"--workers is {workers}, expected 1 or more.")
    if export is not None:
        _export(asked, export, arms, (place, workers), report)
        return
    if arms != 1:
        raise InputError("--arms is for --export; a study has the built-in arm.")
    files = named_files({"--report": report})
    check_writable(files, ())
    with progress_bar() as progress:
        study = run_study(asked, place, progress, workers=workers)
    page = store_page(asked, study, place)
    show(console, *told(study))
    write_all({path: page.read_bytes() for path in files.values()})
    say(console, f"\nreport: {report or page}")
    if study.failed:
        raise RunError(f"{len(study.failed)} of {n} cases failed: {study.failed[0]}")


def _export(
    asked: Asked,
    export: str,
    arms: int,
    run: tuple[Path, int | None],
    report: str | None,
) -> None:
    if report is not None:
        raise InputError("--export diagnoses nothing, so it has no --report.")
    if not 1 <= arms <= MOST_ARMS:
        raise InputError(f"--arms is {arms}, expected 1 to {MOST_ARMS}.")
    target, (place, workers) = Path(export), run
    check_target(target)
    with progress_bar() as progress, Pool(workers or cores()) as pool:
        export_study(asked, range(arms), target, (place, pool), progress)
    say(Console(), f"wrote {export}: {asked.n} cases; its README.md says what is where")
