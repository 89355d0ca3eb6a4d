"""Check logs from Python: their faults, and the line that mends each."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from flows.inputs.logs import LogSets, read_sets
from flows.steps.check import check as check_sets
from residual.check.result import LogCheck
from residual.recording import Recording
from residual.robot.robot import Robot
from warehouse.logs import ColumnMap, load_columns


def check(
    robot: Robot,
    logs: Recording | str | Path | Iterable[Recording | str | Path],
    columns: str | Path | None = None,
    declared: Sequence[str] | None = None,
) -> LogCheck:
    """Check whether logs are what they say they are (docs/check.md).

    Args:
        robot: The arm.
        logs: Recordings; or files, which may be such as ``read_logs`` refuses.
        columns: The COLUMNS.toml that they were or are to be read with: the lines that
            mend them are for it. None for the default columns.
        declared: Effects that the model has; None for the robot's own list.

    Raises:
        InputError: If a file is not usable.
    """
    given = [logs] if isinstance(logs, Recording | str | Path) else list(logs)
    read = [log for log in given if isinstance(log, Recording)]
    if len(read) < len(given):
        words = [str(log) for log in given if not isinstance(log, Recording)]
        place = columns and str(columns)
        files = read_sets((words, (), ()), robot, place, None, to_check=True)
        doubts, read = files.doubts, [*read, *files.fit]
    else:
        doubts = ()
    known = load_columns(columns) if columns else ColumnMap()
    return check_sets(
        LogSets(robot, tuple(read), columns=known, doubts=doubts), declared
    )
