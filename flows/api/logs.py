"""Measured logs and stored runs as recordings."""

import functools
import re
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numpy as np

from flows.inputs import LogSets, apply_known_values, load_command_robot, read_log_sets
from flows.outputs import check_new_folder, write_files
from flows.requests import Import
from flows.settings import resolve_store_folder
from flows.steps import imports
from flows.steps.check import check_log_sets as check_sets
from flows.steps.export import export_model
from residual.check.result import LogCheck
from residual.errors import InputError, ModelgapError, shorten_value
from residual.export.model_export import AnyModel, ModelExport
from residual.model.compare import compute_model_errors as core_compare
from residual.model.compare import prepare_held_out
from residual.model.lookup import CorrectedModel
from residual.model.model import Model
from residual.recording import Recording
from residual.robot.robot import Robot
from residual.verdict.diagnosis import tabulate_errors
from residual.verdict.result import ErrorTables
from warehouse.logs import ColumnMap, check_logs_distinct, choose_column_map, read_memory_log

P, T = ParamSpec("P"), TypeVar("T")
# Messages name options of the shell; from Python they name arguments. Commands that a
# message quotes ("modelgap map ...") stay.
_ARGUMENTS = {
    "--trust-log (trust_log=True)": "trust_log=True",
    "--map COLUMNS.toml": 'columns="COLUMNS.toml"',
    "--chain a,b,c": 'load_robot(..., chain=["a", "b", "c"])',
    "--map": "COLUMNS.toml (columns=...)",
    "--chain": "load_robot(..., chain=[...])",
    "--tip": "load_robot(..., tip=...)",
    "--xacro-arg": "load_robot(..., xacro_args=[...])",
    "--package-dir": "load_robot(..., package_dirs=[...])",
    "--robot": "robot",
    "--holdout": "held_out=...",
    "--baseline": "baseline=...",
    "--declared": "declared=[...]",
    "--known": "known={...}",
    "--trust-log": "trust_log=True",
    "--consistent": "consistent=True",
    "--recorded-at": "recorded_at=...",
}
_OPTION = re.compile(
    r"(?P<command>modelgap [a-z]+ [^\n]*?(?=\.\s|[.;)]*$|\n))|"
    rf"(?P<option>{'|'.join(map(re.escape, _ARGUMENTS))})(?![\w-])"
)


def name_arguments(text: str) -> str:
    """Return a message with the argument in place of each option that has one."""
    return _OPTION.sub(lambda m: m["command"] or _ARGUMENTS[m["option"]], text)


def advise_in_python(function: Callable[P, T]) -> Callable[P, T]:
    """Let the errors of a function name its arguments."""

    @functools.wraps(function)
    def call(*arguments: P.args, **options: P.kwargs) -> T:
        try:
            return function(*arguments, **options)
        except ModelgapError as error:
            error.args = (name_arguments(str(error)), *error.args[1:])
            raise

    return call


__all__ = ["check", "compare", "export", "import_logs", "load_robot", "read_logs", "recording"]
load_robot = advise_in_python(load_command_robot)
Log = str | Path | Mapping[str, Any] | Any  # file, id, columns by name, data frame


def check_robot(robot: Any) -> None:
    """Refuse anything but a robot of ``load_robot``, such as its name."""
    if not isinstance(robot, Robot):
        raise InputError(f"robot: expected what mg.load_robot returns, got {_kind(robot)}.")


def check_recordings(name: str, logs: Any) -> tuple[Recording, ...]:
    """Return one or several recordings as a tuple; InputError for anything else."""
    entries = (logs,) if isinstance(logs, str | Recording) else tuple(logs)
    for entry in entries:
        if not isinstance(entry, Recording):
            raise InputError(
                f"{name}: expected recordings, such as mg.read_logs returns, got {_kind(entry)}."
            )
    return entries


def _kind(value: Any) -> str:
    text = isinstance(value, str)
    return f"'{shorten_value(value)}'" if text else f"a {type(value).__name__}"


@advise_in_python
def read_logs(
    logs: Log | Iterable[Log],
    robot: Robot,
    columns: str | Path | None = None,
    store: str | Path | None = None,
) -> tuple[Recording, ...]:
    """Read logs of one robot: CSV, Parquet, RobotStudio, ROS bag, MCAP, or stored runs.

    What is odd but usable is a Python warning.

    Args:
        logs: One or several: files, windows of files ("run.csv@0:60%"), ids of stored
            runs, mappings or data frames with the columns of a log.
        robot: The arm that was logged.
        columns: COLUMNS.toml for other column names and units (docs/logs.md).
        store: Folder of the runs; None for $MODELGAP_STORE, else ./store.

    Returns:
        One recording per log, in their order.

    Raises:
        InputError: If a log is not usable, or two share samples.
    """
    check_robot(robot)
    alone = isinstance(logs, str | Path) or _is_table(logs)
    entries: list[Any] = [logs] if alone else list(logs)  # pyright: ignore
    files = [str(log) for log in entries if isinstance(log, str | Path)]
    read = read_log_sets((files, (), ()), robot, columns and str(columns), store)
    column_map, messages = choose_column_map(robot, columns), list(read.warnings)
    of_files = iter(read.fit)
    out: list[Recording] = []
    for log in entries:
        if isinstance(log, str | Path):
            out.append(next(of_files))
        else:
            one, about = read_memory_log(log, robot, column_map, f"log {len(out) + 1}")
            messages += about.warnings
            out.append(one)
    check_logs_distinct(out)
    for message in messages:
        warnings.warn(name_arguments(message), stacklevel=3)
    return tuple(out)


def _is_table(log: Any) -> bool:
    """Whether a log has columns by name: a mapping or a frame, no list or array."""
    frame = hasattr(log, "columns") or hasattr(log, "column_names")
    return isinstance(log, Mapping) or (frame and hasattr(log, "__getitem__"))


@advise_in_python
def import_logs(
    logs: str | Path | Iterable[str | Path],
    robot: str | Path,
    store: str | Path | None = None,
    *,
    columns: str | Path | None = None,
    trajectory: str | None = None,
    kind: str = "log",
    serial: str | None = None,
    tags: Sequence[str] = (),
    recorded_at: str | None = None,
    trust_log: bool = False,
) -> tuple[str, ...]:
    """Check logs and store them as runs, as ``modelgap import`` does; return their ids.

    A log that is stored already is not stored again. Warnings are Python warnings.

    Args:
        logs: Files, or windows of files ("run.csv@0:60%").
        robot: Built-in name, robot file or folder; its description is stored too.
        store: Folder of the store; None for $MODELGAP_STORE, else ./store.
        columns: COLUMNS.toml (docs/logs.md).
        trajectory, kind: Words for the kind of motion and the purpose, for queries.
        serial: Serial number of the arm, as in its robot.toml.
        tags: Words, or KEY=VALUE, such as "cell=4".
        recorded_at: Time of the first sample of one log, in ISO 8601.
        trust_log: Store logs with a certain fault too (``check``).

    Raises:
        InputError: If a log is not usable, or has a certain fault; then none is stored.
    """
    words = [logs] if isinstance(logs, str | Path) else logs
    request = Import(
        tuple(map(str, words)),
        robot=str(robot),
        columns=columns and str(columns),
        trajectory=trajectory,
        kind=kind,
        store=resolve_store_folder(store and str(store)),
        trust_log=trust_log,
        serial=serial,
        tags=tuple(tags),
        recorded_at=recorded_at,
    )
    arm, read = imports.read_logs(request)
    sound, report = imports.check_logs(request, arm, read)
    of_files = (line for log in read for line in log.summary.warnings)
    for line in (*of_files, *report.sentences):
        warnings.warn(name_arguments(line), stacklevel=3)
    return tuple(imports.store_log(log, request, arm) for log in sound)


@advise_in_python
def recording(
    robot: Robot, *, t: Any, q: Any, tau: Any, qd: Any = None, id: str = "log"
) -> Recording:
    """Return a log of arrays, checked as a file is.

    Args:
        robot: The arm that was logged.
        t: Sample times [s]. Shape (n,).
        q: Joint positions, link side [rad]. Shape (n, dof).
        tau: Joint torques, link side [N m]. Shape (n, dof).
        qd: Measured joint velocities [rad/s]. Shape (n, dof).
        id: Name of the log.

    Raises:
        InputError: If a shape is wrong, or the arm cannot have made this log: too
            short, without motion, beyond its range.
    """
    check_robot(robot)
    arrays = {"t": t, "q": q, "tau": tau, "qd": qd}
    columns = {name: np.asarray(x) for name, x in arrays.items() if x is not None}
    for name, x in columns.items():
        shape = (columns["t"].size, *([] if name == "t" else [robot.dof]))
        if x.shape != shape:
            raise InputError(f"{id}: {name} has shape {x.shape}, expected {shape}.")
    log, about = read_memory_log(columns, robot, ColumnMap(), id)
    for line in about.warnings:
        warnings.warn(name_arguments(line), stacklevel=3)
    return log


@advise_in_python
def compare(models: Mapping[str, Model | CorrectedModel], logs: Sequence[Recording]) -> ErrorTables:
    """Return the errors of several models of one robot on the same logs.

    Args:
        models: By name; logs are filtered as the first of them says.
        logs: Logs that none of them was fitted to.

    Returns:
        100·||tau - tau_hat||/||tau|| per joint and over all joints, by model.
    """
    logs = check_recordings("logs", logs)
    if not isinstance(models, Mapping) or not models or not logs:
        raise InputError('Nothing to compare: give models by name, as {"with": model}, and a log.')
    first = next(iter(models.values()))
    base = first.model if isinstance(first, CorrectedModel) else first
    held_out = prepare_held_out(logs, base)
    errors, _ = core_compare(models, held_out, base.filters)
    cutoff = min(one.track.cutoff for one in held_out)
    return tabulate_errors(errors, cutoff, [log.id for log in logs])


@advise_in_python
def export(
    model: AnyModel, to: str, folder: str | Path, log: Recording | None = None
) -> ModelExport:
    """Write a model in the form of another program.

    Args:
        model: The model, with or without look-up tables.
        to: urdf, mjcf, mujoco, c99, table, rrd or json.
        folder: A new folder for the files.
        log: With rrd: a log of the robot, to show its torque and its residual.

    Returns:
        The files; `left` lists what the target cannot represent.

    Raises:
        InputError: If there is no such target, it cannot take the model, the folder is
            not empty, or a package is not installed.
    """
    check_new_folder("folder", Path(folder))
    exported = export_model(model, to, log)
    Path(folder).mkdir(exist_ok=True)
    write_files({Path(folder) / name: text for name, text in exported.files.items()})
    return exported


@advise_in_python
def check(
    robot: Robot,
    logs: Recording | str | Path | Iterable[Recording | str | Path],
    columns: str | Path | None = None,
    known: Mapping[str, float] | None = None,
) -> LogCheck:
    """Check units, signs, joint order and timing of logs (docs/check.md).

    Args:
        robot: The arm.
        logs: Recordings; or files, also such as ``read_logs`` refuses.
        columns: COLUMNS.toml of the files; the repair lines are for it.
        known: Values that are known for sure, such as {"payload.mass": 0.5} [SI].

    Raises:
        InputError: If a file is not usable.
    """
    check_robot(robot)
    robot = apply_known_values(robot, known or {})
    entries = [logs] if isinstance(logs, Recording | str | Path) else list(logs)
    if not entries:
        raise InputError("No log to check: give one recording or file, or several.")
    recordings = [log for log in entries if isinstance(log, Recording)]
    words = [str(log) for log in entries if not isinstance(log, Recording)]
    doubts = ()
    if words:
        place = columns and str(columns)
        files = read_log_sets((words, (), ()), robot, place, None, to_check=True)
        doubts, recordings = files.doubts, [*recordings, *files.fit]
    column_map = choose_column_map(robot, columns) or ColumnMap()
    sets = LogSets(robot, tuple(recordings), columns=column_map, doubts=doubts)
    return check_sets(sets)
