"""A bar on standard error while the program works, and none where nobody looks."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bar

# Told the stage and the share done.
Progress = Callable[[str, float], None]


@contextmanager
def progress_bar() -> Iterator[Progress | None]:
    """Show a bar from the first stage that is told until the block ends.

    Yields:
        A function that takes the stage and the fraction done, or None where standard
        error is not a terminal.
    """
    console = Console(stderr=True)
    if not console.is_terminal:
        yield None
        return
    bar = Bar(
        BarColumn(bar_width=24),
        TimeElapsedColumn(),
        TextColumn("{task.description}", markup=False),
        console=console,
        transient=True,
        # Otherwise what is meant for standard output would go to standard error.
        redirect_stdout=False,
        redirect_stderr=False,
    )
    task = bar.add_task("", total=1.0)

    def tell(stage: str, done: float) -> None:
        bar.start()
        bar.update(task, description=stage, completed=done)

    try:
        yield tell
    finally:
        bar.stop()
