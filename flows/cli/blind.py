"""modelgap blind: the sealed study, which says how often the diagnosis is right."""

from typing import Annotated

from cyclopts import Parameter
from rich.console import Console

from flows.blind.draw import Asked
from flows.blind.run import run_study
from flows.cli.options import LONGEST, SEEDS, check_between, named_files
from flows.errors import RunError
from flows.outputs import check_writable, write_all
from flows.progress import progress_bar
from flows.report.study import store_page, tell_study
from flows.say import say
from flows.settings import store_folder
from residual.errors import InputError
from sim.records import WORKSHOP, BackgroundWord


def blind(
    *,
    n: Annotated[int, Parameter(name="--n")] = 20,
    seed: int = 0,
    store: str | None = None,
    report: str | None = None,
    workers: int | None = None,
    duration: float = 20.0,
    background: BackgroundWord = WORKSHOP,
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

    Args:
        n: Number of cases; 20 to 30 s of one core each.
        seed: Seed of everything; the same seed is the same study.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
        report: HTML page to write; it is in the store in any case.
        workers: Number of processes; one per core without it.
        duration: Length of every experiment [s].
        background: What all joints have beside what is hidden: nothing, that of an arm
            in use, or twice as much.
    """
    place, console = store_folder(store), Console()
    check_between("--seed", seed, 0, SEEDS)
    check_between("--duration", duration, 0.1, LONGEST)
    asked = Asked(n, seed, duration=duration, background=background)
    if workers is not None and workers < 1:
        raise InputError(f"--workers is {workers}, expected 1 or more.")
    files = named_files({"--report": report})
    check_writable(files, ())
    with progress_bar() as progress:
        study = run_study(asked, place, progress, workers=workers)
    page = store_page(asked, study, place)
    tell_study(study, console)
    write_all({path: page.read_bytes() for path in files.values()})
    say(console, f"\nreport: {report or page}")
    if study.failed:
        raise RunError(f"{len(study.failed)} of {n} cases failed: {study.failed[0]}")
