"""What surrounds a flow and cannot be a parameter of it: who is told, which processes.

Prefect keeps the parameters of flows and tasks as JSON; a progress bar and a pool of
processes are neither. They are the same for all of one command.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

from flows.outputs import Progress
from flows.workers.pool import Pool


@dataclass(frozen=True, slots=True)
class Surroundings:
    """Surroundings of a flow.

    Attributes:
        progress: Told the stage and the share done; None where nobody listens.
        pool: Processes to use; None for own ones.
    """

    progress: Progress | None = None
    pool: Pool | None = None


_NOW: ContextVar[Surroundings] = ContextVar("surroundings", default=Surroundings())  # noqa: B039


def surroundings() -> Surroundings:
    """Return the surroundings of the flow that runs."""
    return _NOW.get()


@contextmanager
def surrounded(by: Surroundings) -> Iterator[None]:
    """Give flows that are started inside these surroundings."""
    token = _NOW.set(by)
    try:
        yield
    finally:
        _NOW.reset(token)
