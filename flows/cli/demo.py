"""modelgap demo."""

from dataclasses import replace

from rich.console import Console

from flows.cli.app import SEEDS, check_between
from flows.outputs import progress_bar, say
from flows.report.diagnosis import print_diagnosis, print_truth
from flows.report.phrases import Demonstration
from flows.report.stored import demo_page, hidden_effects
from flows.settings import store_folder
from flows.steps import demo as steps
from flows.steps.diagnose import diagnose_runs, request_of
from flows.storage.diagnosis import read_outcome
from warehouse.remote import store_name

_DEFAULT = steps.Demo()


def demo(*, request: steps.Demo = _DEFAULT) -> None:
    """Find the hidden effect of a simulated arm.

    Runs six experiments of three motion families in a physics engine, and two held-out
    ones; diagnoses the stored logs, writes a report, then opens the sealed truth and
    prints it next to the verdict. Stored runs are not repeated.

    ```
    modelgap demo
    modelgap demo --effect spring --seed 3
    ```
    """
    place, console = store_folder(request.store), Console()
    check_between("--seed", request.seed, 0, SEEDS)
    request = replace(request, store=place)
    # Before anything is started, so that a wrong word is answered at once.
    count = len(steps.specs(request))
    arm = f"the simulated {steps.ROBOT}, background {request.background}"
    say(console, f"{count} experiments on {arm}, into {store_name(place)}")
    with progress_bar() as progress:
        runs = steps.run_experiments(request, progress)
        ids = diagnose_runs(request_of(runs, place), progress)
        hidden = steps.open_seal(runs, place)
        page = demo_page(ids, runs["fit"][0], hidden, place)
    outcome = read_outcome(place, ids[1])
    print_diagnosis(outcome, console)
    print_truth(
        Demonstration(b"", "", hidden_effects(hidden), outcome.verdict), console
    )
    say(console, f"\nreport: {page}")
