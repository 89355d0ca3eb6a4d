"""modelgap demo: the main job on an arm of our own, the truth shown last."""

from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from flows.cli.options import SEEDS, Flag, check_between
from flows.outputs import Progress, progress_bar, say
from flows.report.diagnosis import print_diagnosis, print_truth
from flows.report.stored import as_hidden, demo_page
from flows.report.words.staged import Staged
from flows.requests import Demo
from flows.settings import store_folder
from flows.steps import demo as steps
from flows.steps.diagnose import diagnose_runs, request_of
from flows.storage.diagnosis import read_outcome
from sim.records import CLEAN, BackgroundWord
from warehouse.objects.mirror import shown


@dataclass(frozen=True, slots=True)
class Made:
    """What a demonstration left in the store.

    Attributes:
        diagnosis: Id of the diagnosis.
        proof: Id of the validation with its curves.
        hidden: What was under the seal, as JSON can hold it.
        page: The report.
    """

    diagnosis: str
    proof: str
    hidden: list[dict]
    page: Path


def run(asked: Demo, progress: Progress | None = None) -> Made:
    """Do all steps one after the other.

    Args:
        asked: Which demonstration.
        progress: Told the stage and the share done.
    """
    store = store_folder(asked.store)
    runs = steps.run_experiments(asked, progress)
    ids = diagnose_runs(request_of(runs, store), progress)
    hidden = steps.open_seal(runs, ids[0], store)
    return Made(*ids, hidden, demo_page(ids, runs["fit"][0], hidden, store))


def demo(
    *,
    seed: int = 7,
    effect: str | None = None,
    store: str | None = None,
    plain: Flag = False,
    background: BackgroundWord = CLEAN,
) -> None:
    """Find the effect that a simulated arm hides from its model.

    Runs six experiments of three families on the arm in a physics engine, and two that
    no fit will see; stores them, finds from the stored logs what the model lacks, adds
    it, shows the error before and after, and writes a report. Then the seal is opened
    and the truth shown beside the verdict. Runs are kept: a second time is quicker.

    ```
    modelgap demo
    modelgap demo --effect spring --seed 3
    ```

    Args:
        seed: Seed of the arm, the motions, the noise, and of what is hidden.
        effect: Effect to hide; drawn from the seed without it. "none" hides nothing.
            It is as large as the motions of the arm can show.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
        plain: The same steps without Prefect.
        background: What all joints have beside it: nothing, that of an arm in use, or
            twice as much.
    """
    del plain  # there is no other way any more; who asks for it gets it
    place, console = store_folder(store), Console()
    check_between("--seed", seed, 0, SEEDS)
    asked = Demo(seed, effect, place, background)
    # Before anything is started, so that a wrong word is answered at once.
    count = len(steps.specs(asked))
    arm = f"the simulated {steps.ROBOT}, background {background}"
    say(console, f"{count} experiments on {arm}, into {shown(place)}")
    with progress_bar() as progress:
        made = run(asked, progress)
    outcome = read_outcome(place, made.proof)
    print_diagnosis(outcome, console)
    print_truth(Staged(b"", "", as_hidden(made.hidden), outcome.verdict), console)
    say(console, f"\nreport: {made.page}")
