"""Measured logs and stored runs as recordings."""

import warnings
from collections.abc import Iterable
from pathlib import Path

from flows.inputs.logs import read_sets
from residual.recording import Recording
from residual.robot.robot import Robot


def read_logs(
    logs: str | Path | Iterable[str | Path],
    robot: Robot,
    columns: str | Path | None = None,
    store: str | Path | None = None,
) -> tuple[Recording, ...]:
    """Read logs of one robot: CSV, Parquet, RobotStudio, ROS bag, MCAP, or stored runs.

    What is odd but usable is a Python warning.

    Args:
        logs: Files, windows of files ("run.csv@0:60%"), or ids of runs of the store.
        robot: The arm that was logged.
        columns: COLUMNS.toml for other column names and units (docs/logs.md).
        store: Where the runs are; None for the usual place.

    Returns:
        One recording per log, in their order.

    Raises:
        InputError: If a log is not usable, or two share samples.
    """
    words = [logs] if isinstance(logs, str | Path) else logs
    names = [str(word) for word in words]
    read = read_sets((names, (), ()), robot, columns and str(columns), store)
    for line in read.warnings:
        warnings.warn(line, stacklevel=2)
    return read.fit
