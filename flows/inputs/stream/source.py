"""What every source of samples is, and what it hands over."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from flows.inputs.stream.lines import Reader, reader_of
from residual.monitoring.rows import Samples
from residual.robot.robot import Robot
from warehouse.logs.columns import ColumnMap

POLL = 0.2  # s between two looks


@dataclass(frozen=True, slots=True)
class Meaning:
    """What lines are lines of.

    Attributes:
        robot: The arm.
        columns: Which column is what.
    """

    robot: Robot
    columns: ColumnMap

    def reader(self, line: str, where: str) -> Reader:
        """Return what the lines after a line of names mean."""
        return reader_of(line, self.robot, self.columns, where)


@dataclass(frozen=True, eq=False, slots=True)
class Batch:
    """What has come since the last look.

    Attributes:
        samples: Samples in their order; None for none.
        notes: What there is to say, a line each.
        more: Whether to look again at once.
    """

    samples: Samples | None = None
    notes: tuple[str, ...] = ()
    more: bool = False


class Source(Protocol):
    """Where samples come from."""

    @property
    def name(self) -> str:
        """What messages call it."""
        ...

    def read(self) -> Batch:
        """Return what has come; never waits."""
        ...

    def wait(self) -> None:
        """Wait until there may be more, for a moment at most."""
        ...

    def position(self) -> dict:
        """Return where to go on after a restart, as JSON can hold it."""
        ...

    def close(self) -> None:
        """Let go of what is held."""
        ...


Open = Callable[[dict | None], Source]


def whole_lines(text: bytes) -> tuple[list[str], int]:
    """Return the lines that have an end, and how many bytes they are."""
    end = text.rfind(b"\n") + 1
    lines = text[:end].decode("utf-8-sig", errors="replace").split("\n")
    return [line.rstrip("\r") for line in lines if line.strip()], end


def joined(parts: Sequence[Samples]) -> Samples | None:
    """Return samples one after the other, None for none."""
    if not parts:
        return None
    names = ("t", "q", "tau")
    return Samples(*(np.concatenate([getattr(p, n) for p in parts]) for n in names))
