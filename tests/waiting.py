"""Wait until something holds, however busy the machine is."""

from collections.abc import Callable
from time import monotonic, sleep
from typing import TypeVar

PATIENCE = 600.0  # s; what has not happened by then never will
T = TypeVar("T")


def until(condition: Callable[[], T], what: str, every: float = 0.05) -> T:
    """Ask again and again; return the first answer that is true."""
    last = monotonic() + PATIENCE
    while not (answer := condition()):
        assert monotonic() < last, f"after {PATIENCE:g} s still not: {what}"
        sleep(every)
    return answer
