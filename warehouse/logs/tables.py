"""A log file as named columns, read only where they are asked for."""

from abc import ABC, abstractmethod
from pathlib import Path

import numpy as np

from residual.errors import InputError
from warehouse.logs.columns import CsvFormat

Array = np.ndarray


class LogFile(ABC):
    """An opened log file.

    Attributes:
        name: File name, as messages begin.
        columns: Names of all columns.
    """

    name: str
    columns: tuple[str, ...]

    @abstractmethod
    def read(self, columns: tuple[str, ...]) -> dict[str, Array]:
        """Return the values of some columns, NaN where empty.

        Raises:
            InputError: If a value is not a number.
        """


def open_log(path: Path, csv: CsvFormat) -> LogFile:
    """Open a log by what is in it; its name does not matter.

    Args:
        path: An existing file.
        csv: How text is written.

    Returns:
        The opened log.

    Raises:
        InputError: If the file is empty or neither text nor Parquet.
    """
    # Late, so that nobody waits for a format he does not use.
    from warehouse.logs.csv import CsvLog
    from warehouse.logs.parquet import ParquetLog

    try:
        with path.open("rb") as file:
            head = file.read(1 << 16)
    except OSError as error:
        raise InputError(f"Cannot read {path}: {error.strerror}.") from error
    if not head.strip():
        raise InputError(f"{path.name} is empty, expected a log with samples.")
    if head.startswith(b"PAR1"):
        return ParquetLog(path)
    if any(c < 32 and c not in b"\t\r\n\f" for c in head):
        raise InputError(
            f"{path.name} is binary but not Parquet, expected CSV text (UTF-8) or "
            "Parquet. Export the log as one of them."
        )
    return CsvLog(path, head, csv)
