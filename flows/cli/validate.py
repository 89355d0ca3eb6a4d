"""modelgap validate: how far the nominal model gets by itself on a run."""

from rich.console import Console

from flows.report.terminal.validation import meaning, validation_table
from flows.requests import Validate
from flows.say import say
from flows.settings import store_folder
from flows.steps import validate as steps


def validate(run: str, /, *, window: float = 0.25, store: str | None = None) -> None:
    """Try the nominal model on a run of the store, without fitting anything.

    ```
    modelgap validate 3f2a
    modelgap validate 3f2a --window 0.1
    ```

    Open loop: under the logged torque alone, window by window, how far does the model
    stray from what was measured? Feed-forward, on simulated runs: driven by the
    model's torque, how well does the arm track its reference, and how well when
    driven by its own? Root mean square per joint; the store keeps it.

    Args:
        run: Id of a run; the beginning is enough.
        window: Length of the windows in seconds; errors grow quickly with it.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
    """
    place, console = store_folder(store), Console()
    id, made = steps.validate(Validate(run, window, place))
    console.print(validation_table(made))
    stored = f"stored in {place}: modelgap show {id}"
    say(console, meaning(made), *made.notes, stored)
