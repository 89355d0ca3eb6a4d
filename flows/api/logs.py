"""Measured logs and stored runs as recordings."""

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from flows.inputs.given import LogSets, read_sets
from flows.inputs.given import load as load_robot
from flows.outputs import check_new_folder, write_all
from flows.steps.check import check as check_sets
from flows.steps.export import export_model, in_place
from residual.check.result import LogCheck
from residual.diagnosis.result import ErrorTables
from residual.errors import InputError, shortened
from residual.export.exported import Exported, Whole
from residual.model.compare import compare as core_compare
from residual.model.compare import prepare_held_out
from residual.model.corrected import Corrected
from residual.model.model import Model
from residual.recording import Recording
from residual.robot.robot import Robot
from residual.verdict.result import error_tables
from warehouse.logs import ColumnMap, check_distinct, columns_of, read_table

__all__ = ["check", "compare", "export", "load_robot", "read_logs", "recording"]
Given = str | Path | Mapping[str, Any] | Any  # file, id, columns by name, data frame


def check_robot(robot: Any) -> None:
    """Refuse what is no robot: a name is a word for one."""
    if not isinstance(robot, Robot):
        raise InputError(
            f"robot: expected what mg.load_robot returns, got {_kind(robot)}."
        )


def as_logs(name: str, logs: Any) -> tuple[Recording, ...]:
    """Return recordings; names of files have to be read before.

    Raises:
        InputError: If one is none.
    """
    alone = isinstance(logs, str | Recording) or not isinstance(logs, Iterable)
    given = (logs,) if alone else tuple(logs)
    wrong = [one for one in given if alone or not isinstance(one, Recording)]
    if wrong:
        raise InputError(
            f"{name}: expected a list of recordings, such as mg.read_logs returns, got "
            f"{_kind(wrong[0])}."
        )
    return given


def check_declared(declared: Any) -> None:
    """Refuse one name for a list: its letters would be taken for names."""
    if isinstance(declared, str):
        raise InputError(
            f"declared: expected a list of names, got '{shortened(declared)}'. "
            f"Write {declared.split(',')}."
        )


def _kind(given: Any) -> str:
    text = isinstance(given, str)
    return f"'{shortened(given)}'" if text else f"a {type(given).__name__}"


def read_logs(
    logs: Given | Iterable[Given],
    robot: Robot,
    columns: str | Path | None = None,
    store: str | Path | None = None,
) -> tuple[Recording, ...]:
    """Read logs of one robot: CSV, Parquet, RobotStudio, ROS bag, MCAP, or stored runs.

    What is odd but usable is a Python warning.

    Args:
        logs: Files, windows of files ("run.csv@0:60%"), ids of runs of the store,
            mappings with columns by name, data frames. One, several, or by name: what
            a mapping gives a log, not a column, is called by its key.
        robot: The arm that was logged.
        columns: COLUMNS.toml for other column names and units (docs/logs.md).
        store: Where the runs are; None for the usual place.

    Returns:
        One recording per log, in their order.

    Raises:
        InputError: If a log is not usable, or two share samples.
    """
    check_robot(robot)
    named = _named(logs)
    files = [str(log) for _, log in named if isinstance(log, str | Path)]
    read = read_sets((files, (), ()), robot, columns and str(columns), store)
    known, told, of_files = (
        columns_of(robot, columns),
        list(read.warnings),
        iter(read.fit),
    )
    out: list[Recording] = []
    for name, log in named:
        if isinstance(log, str | Path):
            own = next(of_files)
            out.append(replace(own, id=name) if name and name != own.id else own)
        else:
            one, about = read_table(log, robot, known, name or f"log {len(out) + 1}")
            told += about.warnings
            out.append(one)
    check_distinct(out)
    for line in told:
        warnings.warn(line, stacklevel=2)
    return tuple(out)


def _named(logs: Any) -> list[tuple[str, Any]]:
    """Return logs with their names, "" where none is given."""
    if isinstance(logs, Mapping):
        whole = [isinstance(v, str | Path) or _is_table(v) for v in logs.values()]
        if whole and all(whole):
            return [(str(name), log) for name, log in logs.items()]
        return [("", logs)]
    one = isinstance(logs, str | Path) or _is_table(logs)
    return [("", log) for log in ([logs] if one else logs)]


def _is_table(given: Any) -> bool:
    """Whether this has columns by name: a mapping or a frame, no list or array."""
    frame = hasattr(given, "columns") or hasattr(given, "column_names")
    return isinstance(given, Mapping) or (frame and hasattr(given, "__getitem__"))


def recording(
    robot: Robot, *, t: Any, q: Any, tau: Any, qd: Any = None, id: str = "log"
) -> Recording:
    """Return a log of arrays, checked as a file is; ``read_logs`` takes tables.

    Args:
        robot: The arm that was logged.
        t: Sample times [s]. Shape (n,).
        q: Joint positions, link side [rad]. Shape (n, dof).
        tau: Joint torques, link side [N m]. Shape (n, dof).
        qd: Joint velocities where they were measured [rad/s]. Shape (n, dof).
        id: What the log is called.

    Raises:
        InputError: If something has another shape, or can be none of this arm: too
            short, without motion, beyond its range.
    """
    check_robot(robot)
    arrays = {"t": t, "q": q, "tau": tau, "qd": qd}
    given = {name: np.asarray(x) for name, x in arrays.items() if x is not None}
    for name, x in given.items():
        shape = (given["t"].size, *([] if name == "t" else [robot.dof]))
        if x.shape != shape:
            raise InputError(f"{id}: {name} has shape {x.shape}, expected {shape}.")
    one, about = read_table(given, robot, ColumnMap(), id)
    for line in about.warnings:
        warnings.warn(line, stacklevel=2)
    return one


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
    if not isinstance(models, Mapping):
        raise InputError(
            'models: expected models by name, as {"with": model}, got '
            f"{_kind(models)}."
        )
    logs = as_logs("logs", logs)
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
) -> Exported:
    """Write a model in the form of another program.

    Args:
        model: The model, with tables on it or without.
        to: urdf, mjcf, mujoco, c99, table, fmu, rrd or json.
        folder: A new folder for the files.
        log: With rrd: a log of the robot, to see its torque and its residual.

    Returns:
        Its files; `left` is what is not carried.

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
) -> LogCheck:
    """Check whether logs are what they say they are (docs/check.md).

    Args:
        robot: The arm.
        logs: Recordings; or files, which may be such as ``read_logs`` refuses.
        columns: The COLUMNS.toml that they were or are to be read with: the lines that
            mend them are for it. None for the default columns.

    Raises:
        InputError: If a file is not usable.
    """
    check_robot(robot)
    given = [logs] if isinstance(logs, Recording | str | Path) else list(logs)
    if not given:
        raise InputError("No log to check: give one recording or file, or several.")
    read = [log for log in given if isinstance(log, Recording)]
    if len(read) < len(given):
        words = [str(log) for log in given if not isinstance(log, Recording)]
        place = columns and str(columns)
        files = read_sets((words, (), ()), robot, place, None, to_check=True)
        doubts, read = files.doubts, [*read, *files.fit]
    else:
        doubts = ()
    known = columns_of(robot, columns) or ColumnMap()
    return check_sets(LogSets(robot, tuple(read), columns=known, doubts=doubts))
