"""A bar on standard error while the program works, and lines where nobody looks."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import monotonic

from rich.console import Console
from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bar

# Told the stage and the share done.
Progress = Callable[[str, float], None]
Clock = Callable[[], float]
PAUSE = 15.0  # s between two lines where nobody looks


def plain_lines(say: Callable[[str], None], clock: Clock = monotonic) -> Progress:
    """Return what prints progress as lines, for a log file: one at most in PAUSE.

    Args:
        clock: Tells the time [s].
    """
    last = [clock()]

    def tell(stage: str, done: float) -> None:
        if clock() - last[0] >= PAUSE:
            last[0] = clock()
            say(f"{done:4.0%} {stage}")

    return tell


@contextmanager
def progress_bar() -> Iterator[Progress]:
    """Show a bar from the first stage that is told until the block ends.

    Yields:
        A function that takes the stage and the fraction done. Where standard error is
        not a terminal it prints a plain line now and then, and none in short work.
    """
    console = Console(stderr=True)
    if not console.is_terminal:
        yield plain_lines(lambda line: print(line, file=sys.stderr, flush=True))
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
