"""A log file as named columns, read only where they are asked for."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from residual.errors import InputError
from warehouse.logs.columns import ColumnMap

Array = np.ndarray

_SQLITE = b"SQLite format 3\0"
_ROS1 = b"#ROSBAG V"


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


def open_log(path: Path, columns: ColumnMap, joints: Sequence[str]) -> LogFile:
    """Open a log by what is in it; its name does not matter.

    Args:
        path: An existing file, or the folder of a ROS 2 bag.
        columns: How text is written, and what of a bag is read.
        joints: Names of the robot's joints in the URDF, joint 1 first.

    Returns:
        The opened log.

    Raises:
        InputError: If the file is empty or of no known format.
    """
    # Late, so that nobody waits for a format he does not use.
    head = b"" if path.is_dir() else _head(path)
    if path.is_dir() or head.startswith((_SQLITE, _ROS1)):
        from warehouse.logs.bag import open_bag

        return open_bag(path, joints, columns.bag)
    if head.startswith(b"\x89MCAP"):
        from warehouse.logs.mcap import open_mcap

        return open_mcap(path, joints, columns.bag)
    if head.startswith(b"PAR1"):
        from warehouse.logs.parquet import ParquetLog

        return ParquetLog(path)
    if any(c < 32 and c not in b"\t\r\n\f" for c in head):
        raise InputError(
            f"{path.name} is binary but not Parquet, a ROS bag or MCAP, expected one "
            "of them or CSV text (UTF-8). Export the log as one of them."
        )
    from warehouse.logs.csv import CsvLog
    from warehouse.logs.signal_viewer import find_layout

    return CsvLog(path, head, columns.csv, find_layout)


def _head(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            head = file.read(1 << 16)
    except OSError as error:
        raise InputError(f"Cannot read {path}: {error.strerror}.") from error
    if not head.strip():
        raise InputError(f"{path.name} is empty, expected a log with samples.")
    return head
