"""What surrounds a flow and cannot be a parameter of it: who is told, which processes.

Prefect keeps the parameters of flows and tasks as JSON; a progress bar and a pool of
processes are neither. They are the same for all of one command.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

from flows.progress import Progress
from flows.workers.pool import Pool


@dataclass(frozen=True, slots=True)
class Around:
    """Surroundings of a flow.

    Attributes:
        tell: Told the stage and the share done; None where nobody listens.
        pool: Processes to use; None for own ones.
    """

    tell: Progress | None = None
    pool: Pool | None = None


_AROUND: ContextVar[Around] = ContextVar("around", default=Around())  # noqa: B039


def around() -> Around:
    """Return the surroundings of the flow that runs."""
    return _AROUND.get()


@contextmanager
def surrounded(by: Around) -> Iterator[None]:
    """Give flows that are started inside these surroundings."""
    token = _AROUND.set(by)
    try:
        yield
    finally:
        _AROUND.reset(token)
