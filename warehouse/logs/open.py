"""Open a log by what is in it; its name does not matter."""

from collections.abc import Sequence
from pathlib import Path

from residual.errors import InputError
from warehouse.logs.columns import ColumnMap
from warehouse.logs.file import LogFile
from warehouse.logs.formats.bag import open_bag
from warehouse.logs.formats.csv import CsvLog
from warehouse.logs.formats.mcap import open_mcap
from warehouse.logs.formats.parquet import ParquetLog
from warehouse.logs.formats.signal_viewer import find_layout

_SQLITE = b"SQLite format 3\0"
_ROS1 = b"#ROSBAG V"


def open_log(path: Path, columns: ColumnMap, joints: Sequence[str]) -> LogFile:
    """Open a log.

    Args:
        path: An existing file, or the folder of a ROS 2 bag.
        columns: How text is written, and what of a bag is read.
        joints: Names of the robot's joints in the URDF, joint 1 first.

    Returns:
        The opened log.

    Raises:
        InputError: If the file is empty or of no known format.
    """
    head = b"" if path.is_dir() else _head(path)
    if path.is_dir() or head.startswith((_SQLITE, _ROS1)):
        return open_bag(path, joints, columns.bag)
    if head.startswith(b"\x89MCAP"):
        return open_mcap(path, joints, columns.bag)
    if head.startswith(b"PAR1"):
        return ParquetLog(path)
    if any(c < 32 and c not in b"\t\r\n\f" for c in head):
        raise InputError(
            f"{path.name} is binary but not Parquet, a ROS bag or MCAP, expected one "
            "of them or CSV text (UTF-8). Export the log as one of them."
        )
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
