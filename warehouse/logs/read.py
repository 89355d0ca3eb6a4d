"""One log: opened by what is in it, read into a checked recording."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from residual.errors import InputError, RecordingError
from residual.recording import Recording
from residual.robot.robot import Robot
from warehouse.logs.check import check_samples, check_time
from warehouse.logs.columns import TIME_UNITS, ColumnMap
from warehouse.logs.convert import Understood, channels_of, describe, to_link_side
from warehouse.logs.file import LogFile
from warehouse.logs.formats.bag import open_bag
from warehouse.logs.formats.csv import CsvLog, find_layout
from warehouse.logs.formats.mcap import open_mcap
from warehouse.logs.formats.parquet import ParquetLog
from warehouse.logs.select import Selection, check_units, select
from warehouse.logs.window import split_spec

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


Array = np.ndarray


def read_log(
    spec: str, robot: Robot, columns: ColumnMap | None = None, label: str | None = None
) -> tuple[Recording, Understood]:
    """Read a log of any known format.

    Args:
        spec: "FILE" or "FILE@start:end".
        robot: The arm that was logged.
        columns: Which column is what; None for t, q1.., tau1.. in SI units.
        label: Id of the recording; None for the file's stem and window.

    Returns:
        The recording, on the log's own clock, and what was understood of the file.

    Raises:
        InputError: If the file, its columns, its samples or the window are not usable.
    """
    columns = columns or ColumnMap()
    path, window = split_spec(spec)
    tail = "" if window is None else f"@{window.text}"
    label = label or f"{path.stem}{tail}"
    log = open_log(path, columns, tuple(robot.model.names)[1:])
    chosen = select(log.columns, columns, robot.dof, path.name)
    check_units(chosen, columns.time_unit, log.units, path.name)
    table = log.read(chosen.used)
    t = table[chosen.time] * (TIME_UNITS[columns.time_unit] * columns.time_scale)
    check_time(t, path.name)
    rows = slice(None) if window is None else window.rows(t, path.name)
    signals = _signals(table, chosen, rows, robot)
    if len(t[rows]) < 2:
        raise RecordingError(f"{label} has {len(t[rows])} samples; widen the window.")
    recording = Recording(id=label, robot=robot.name, t=t[rows], **signals)
    warnings = check_samples(recording, robot)
    words = [describe(name, signal) for name, signal in chosen.signals.items()]
    if columns.time_unit != "s":
        words.insert(0, f"t: {columns.time_unit} to s")
    slower = "" if columns.time_scale == 1 else f"times {columns.time_scale:.6g}"
    if slower:
        words.insert(0, f"t: {slower}")
    channels = [("t", chosen.time, columns.time_unit, slower)]
    channels += [c for n, s in chosen.signals.items() for c in channels_of(n, s)]
    understood = Understood(
        id=label,
        file=str(path),
        window=None if window is None else window.text,
        rows=len(recording.t),
        rate=(len(recording.t) - 1) / recording.duration,
        duration=recording.duration,
        used=chosen.used,
        ignored=chosen.ignored,
        conversions=tuple(word for word in words if word),
        warnings=warnings,
        notes=log.notes,
        channels=tuple(channels),
    )
    return recording, understood


def _signals(
    table: dict[str, Array], chosen: Selection, rows: slice, robot: Robot
) -> dict[str, Array]:
    return {
        name: to_link_side(
            name,
            np.column_stack([table[c][rows] for c in signal.columns]),
            signal,
            robot,
        )
        for name, signal in chosen.signals.items()
    }
