"""Measured logs and stored runs as recordings."""

import warnings
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from flows.inputs.given import LogSets, read_sets
from flows.outputs import check_new_folder, write_all
from flows.steps.check import check as check_sets
from flows.steps.export import Made, export_model, in_place
from residual.check.result import LogCheck
from residual.diagnosis.conclude import error_tables
from residual.diagnosis.result import ErrorTables
from residual.errors import InputError
from residual.export.exported import Whole
from residual.model.compare import compare as core_compare
from residual.model.compare import prepare_held_out
from residual.model.corrected import Corrected
from residual.model.model import Model
from residual.recording import Recording
from residual.robot.robot import Robot
from warehouse.logs import ColumnMap, columns_of


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


def compare(
    models: Mapping[str, Model | Corrected], logs: Sequence[Recording]
) -> ErrorTables:
    """Return the errors of several models of one robot on the same logs.

    Args:
        models: By name. Logs are prepared with the signal path of the first.
        logs: What they are to predict.

    Returns:
        100·||tau - tau_hat||/||tau|| per joint and over all joints, by model.

    Raises:
        InputError: If there is no model or no log.
    """
    if not models or not logs:
        raise InputError("Nothing to compare: give one model or more, and one log.")
    first = next(iter(models.values()))
    base = first.model if isinstance(first, Corrected) else first
    held_out = prepare_held_out(logs, base)
    errors, _ = core_compare(models, held_out, base.filters)
    cutoff = min(one.track.cutoff for one in held_out)
    return error_tables(errors, cutoff, [log.id for log in logs])


def export(
    model: Whole, to: str, folder: str | Path, log: Recording | None = None
) -> Made:
    """Write a model in the form of another program, and try it there.

    Args:
        model: The model, with tables on it or without.
        to: urdf, mjcf, mujoco, c99, numpy, table, fmu, rrd or json.
        folder: A new folder for the files.
        log: With rrd: a log of the robot, to see its torque and its residual.

    Returns:
        `export.left` is what is not carried, `proof` what came back out of the target.

    Raises:
        InputError: If there is no such target, it cannot take the model, the folder is
            not empty, or a package that the target needs is not installed.
    """
    check_new_folder("folder", Path(folder))
    made = export_model(model, to, log)
    Path(folder).mkdir(exist_ok=True)
    write_all(in_place(made, folder))
    return made


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
    known = columns_of(robot, columns) or ColumnMap()
    return check_sets(
        LogSets(robot, tuple(read), columns=known, doubts=doubts), declared
    )
