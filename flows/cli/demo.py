"""modelgap demo: the main job on logs that the program makes itself."""

from pathlib import Path


def demo(seed: int = 7, effect: str = "payload", folder: str = "modelgap-demo") -> None:
    """Diagnose an arm with an effect that its model is not told of.

    Writes synthetic logs of the built-in arm, diagnoses them as if they were
    measured, writes a report, and then opens the truth.

    ```
    modelgap demo
    modelgap demo --effect spring --seed 3
    ```

    Args:
        seed: Seed of motion, noise, and of the effect's joint and size.
        effect: Effect to hide.
        folder: Where logs, report and verdict go.
    """
    from rich.console import Console

    from flows import steps
    from flows.cli.progress import progress_bar
    from flows.demo import DemoRequest, open_the_truth, write_logs

    console = Console()
    asked, truth = write_logs(DemoRequest(seed, effect, Path(folder)))
    with progress_bar() as progress:
        outcome = steps.diagnose(asked, console, progress)
    steps.tell(outcome, asked, console)
    open_the_truth(asked, truth, console)
