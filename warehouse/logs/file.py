"""A log file as named columns, read only where they are asked for."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from datetime import datetime

from residual.recording import Array


class LogFile(ABC):
    """An opened log file.

    Attributes:
        name: File name, as messages begin.
        columns: Names of all columns.
        units: Units that the file itself states, by column.
        notes: What was understood of the file, in words.
        recorded_at: When its first sample was taken, UTC; None where it does not say.
    """

    name: str
    columns: tuple[str, ...]
    units: Mapping[str, str] = {}
    notes: tuple[str, ...] = ()
    recorded_at: datetime | None = None

    @abstractmethod
    def read(self, columns: tuple[str, ...]) -> dict[str, Array]:
        """Return the values of some columns, NaN where empty.

        Raises:
            InputError: If a value is not a number.
        """
