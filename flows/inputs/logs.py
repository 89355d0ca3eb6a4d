"""The logs that a command is given: files, or ids of runs of the store."""

import shlex
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

from flows.settings import store_folder
from residual.errors import InputError
from residual.lazy import Lazy
from residual.recording import Recording
from residual.robot.robot import Robot
from warehouse.logs import (
    ColumnMap,
    Doubt,
    MissingColumnsError,
    check_distinct,
    columns_of,
    read_any,
    read_log,
    unique_ids,
)

runs = Lazy("warehouse.runs")


@dataclass(frozen=True, eq=False, slots=True)
class LogSets:
    """All logs of one command, by what they are for.

    Attributes:
        robot: The arm that was logged.
        fit: Logs to fit; those of runs are called by the beginning of their id.
        baseline: Logs of healthy runs.
        held_out: Logs for the proof.
        lines: What was understood of them, for the user; the first says which log is
            used as what.
        warnings: What is odd but usable.
        runs: Whole ids of those that are runs, by the id of the recording.
        columns: How the files were read.
        doubts: Why logs can be none of this arm, with the label of the log; only where
            they were read for a check.
    """

    robot: Robot
    fit: tuple[Recording, ...]
    baseline: tuple[Recording, ...] = ()
    held_out: tuple[Recording, ...] = ()
    lines: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    runs: Mapping[str, str] | None = None
    columns: ColumnMap = field(default_factory=ColumnMap)
    doubts: tuple[tuple[str, Doubt], ...] = ()


def read_sets(
    sets: tuple[Sequence[str], Sequence[str], Sequence[str]],
    robot: Robot,
    columns: str | None,
    store: str | Path | None,
    to_check: bool = False,
    called: str = "R",
) -> LogSets:
    """Read every log once and make sure that no sample counts twice.

    Args:
        sets: Logs to fit, of the baseline, and held out: "FILE", "FILE@start:end", or
            the id of a run.
        columns: COLUMNS.toml for the files, None for the default columns.
        store: Where the runs are, None for the usual place.
        to_check: Whether a check follows, which tells why samples can be none of this
            arm; without it they are an error.
        called: What the user calls the robot, for a line that is offered.

    Raises:
        InputError: If a log is not usable or shares samples with another.
    """
    place = store_folder(store)
    known = columns_of(robot, columns) or ColumnMap()
    read = read_any if to_check else read_log
    words = [word for part in sets for word in part]
    labels = iter(unique_ids([word for word in words if not is_run(word)]))
    logs: list[Recording] = []
    lines, warnings, runs, doubts = [], [], {}, []
    for word in words:
        if is_run(word):
            log, id, line = _read_run(word, robot, place)
            runs[log.id] = id
        else:
            with offer_map(word, called):
                log, told = read(word, robot, known, next(labels))
            line = told.text
            warnings += told.warnings
            doubts += [(log.id, doubt) for doubt in told.doubts]
        logs.append(log)
        lines.append(line)
    check_distinct(logs)
    rest = iter(logs)
    parts = [tuple(next(rest) for _ in part) for part in sets]
    about = (_use(*parts), *lines)
    told = (about, tuple(warnings), runs)
    return LogSets(robot, *parts, *told, known, tuple(doubts))


@contextmanager
def offer_map(log: str, robot: str) -> Iterator[None]:
    """Say of a log with other columns how a map of them is drafted.

    Args:
        log: The log as the user wrote it.
        robot: What the user calls the robot.
    """
    try:
        yield
    except MissingColumnsError as error:
        words = ["modelgap", "map", log, "--robot", robot, "--out", "COLUMNS.toml"]
        raise MissingColumnsError(
            f"{error} A draft of it: {shlex.join(words)}"
        ) from error


def need_logs(words: Sequence[str], purpose: str, command: str) -> None:
    """Refuse a command without any log.

    Args:
        purpose: What they are needed for, such as "to diagnose".

    Raises:
        InputError: If there is none.
    """
    if not words:
        raise InputError(
            f"No log {purpose}. Name it first: modelgap {command} LOG ... --robot R."
        )


def is_run(word: str) -> bool:
    """Whether a word can only be the id of a run: no such file, and only hex digits."""
    return not Path(word).exists() and not set(word) - set("0123456789abcdef")


def _use(*sets: tuple[Recording, ...]) -> str:
    """Return one line that says which log is used as what."""
    names = ("fit", "baseline", "held out")
    parts = (" ".join(log.id for log in logs) or "–" for logs in sets)
    return " | ".join(f"{n}: {p}" for n, p in zip(names, parts, strict=True))


def _read_run(word: str, robot: Robot, store: Path) -> tuple[Recording, str, str]:
    log = runs.read_run(store, word)
    if log.dof != robot.dof:
        raise InputError(
            f"Run {log.id} has {log.dof} joints, {robot.name} has {robot.dof}. Give "
            "the run's own robot with --robot."
        )
    line = f"{log.id}: run of {log.robot}, {len(log.t)} samples, {log.duration:.2f} s"
    return replace(log, id=log.id[:8]), log.id, line
