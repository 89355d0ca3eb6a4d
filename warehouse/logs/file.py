"""A log file as named columns, read only where they are asked for."""

from abc import ABC, abstractmethod
from collections.abc import Mapping

from residual.recording import Array


class LogFile(ABC):
    """An opened log file.

    Attributes:
        name: File name, as messages begin.
        columns: Names of all columns.
        units: Units that the file itself states, by column.
        notes: What was understood of the file, in words.
    """

    name: str
    columns: tuple[str, ...]
    units: Mapping[str, str] = {}
    notes: tuple[str, ...] = ()

    @abstractmethod
    def read(self, columns: tuple[str, ...]) -> dict[str, Array]:
        """Return the values of some columns, NaN where empty.

        Raises:
            InputError: If a value is not a number.
        """
