"""modelgap demo: the main job on an arm of our own, the truth shown last."""

from rich.console import Console

from flows.cli.demo_run import run_flow, run_plain
from flows.cli.options import SEEDS, Flag, check_between
from flows.keep.diagnosis import read_outcome
from flows.progress import progress_bar
from flows.report.stored import as_hidden
from flows.report.terminal.diagnosis import print_diagnosis, print_truth
from flows.report.words.staged import Staged
from flows.requests import Demo
from flows.say import say
from flows.settings import store_folder
from flows.steps import demo as steps
from sim.records import CLEAN, BackgroundWord
from warehouse.objects.mirror import shown


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
    place, console = store_folder(store), Console()
    check_between("--seed", seed, 0, SEEDS)
    asked = Demo(seed, effect, place, background)
    # Before anything is started, so that a wrong word is answered at once.
    count = len(steps.specs(asked))
    arm = f"the simulated {steps.ROBOT}, background {background}"
    say(console, f"{count} experiments on {arm}, into {shown(place)}")
    with progress_bar() as progress:
        made = (run_plain if plain else run_flow)(asked, progress)
    outcome = read_outcome(place, made.proof)
    print_diagnosis(outcome, console)
    print_truth(Staged(b"", "", as_hidden(made.hidden), outcome.verdict), console)
    say(console, f"\nreport: {made.page}")
