"""What a server tells of flow runs, as the pages show it; made by who can ask one."""

from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime


@dataclass(frozen=True, slots=True)
class FlowRun:
    """A flow run.

    Attributes:
        id: Its id.
        name: Its name.
        state: Type of its state, such as COMPLETED, FAILED, CRASHED, PAUSED.
        begun: When it was begun, or was to begin; UTC without a zone.
        seconds: How long it took [s].
        message: What its state says; "" for nothing.
    """

    id: str
    name: str
    state: str
    begun: datetime
    seconds: float
    message: str = ""

    @property
    def failed(self) -> bool:
        """Whether it ended, and not as it should have."""
        return self.state in ("FAILED", "CRASHED")


@dataclass(frozen=True, slots=True)
class History:
    """The flow runs of some time.

    Attributes:
        runs: Which, latest first.
        warnings: Name of the flow run and what it warned of, the first one first.
    """

    runs: tuple[FlowRun, ...] = ()
    warnings: tuple[tuple[str, str], ...] = ()


# From when, to when [UTC]; None where no server answers.
Past = Callable[[datetime, datetime], History | None]


def unknown(_begin: datetime, _end: datetime) -> None:
    """Where no server is asked."""
    return
